"""What all endpoints share: bounds ahead of reading, errors as answers, permissions."""

from __future__ import annotations

import functools
from typing import Any, Callable, Mapping

from rest_framework import exceptions, permissions, status
from rest_framework.parsers import JSONParser
from rest_framework.response import Response
from rest_framework.views import APIView

from ...stages.errors import SensorgateError
from . import bounds, home, sessions

_SMALL_BODY = 6 * bounds.SHEET_BYTES


class TooLarge(exceptions.APIException):
    """A bound was exceeded."""

    status_code = status.HTTP_413_REQUEST_ENTITY_TOO_LARGE
    default_detail = "The request is too large."


class Conflict(exceptions.APIException):
    """The state does not allow it."""

    status_code = status.HTTP_409_CONFLICT


def plainly(method: Callable[..., Response]) -> Callable[..., Response]:
    """Turn our errors into answers."""

    @functools.wraps(method)
    def answer(*args: Any, **kwargs: Any) -> Response:
        try:
            return method(*args, **kwargs)
        except sessions.TooMuch as error:
            raise TooLarge(str(error)) from None
        except SensorgateError as error:
            raise exceptions.ValidationError({"detail": str(error)}) from None

    return answer


class View(APIView):
    """For users who are logged in. Session authentication brings WebODM's CSRF check along."""

    permission_classes = (permissions.IsAuthenticated,)
    parser_classes = (JSONParser,)
    most_body = _SMALL_BODY

    def initial(self, request: Any, *args: Any, **kwargs: Any) -> None:
        """Refuse a body that is too large before it is read."""
        super().initial(request, *args, **kwargs)
        if request.method == "POST":
            bound(request, self.most_body)

    def body(self) -> Mapping[str, Any]:
        """The JSON object that was sent."""
        data = self.request.data
        if not isinstance(data, dict):
            raise exceptions.ParseError("The body must be a JSON object.")
        return data


def bound(request: Any, most: int) -> None:
    """Refuse a body of unknown or too large size, and count it for its user."""
    try:
        length = int(request.META.get("CONTENT_LENGTH") or 0)
    except ValueError:
        raise exceptions.ParseError("Content-Length is no number.") from None
    if length <= 0:
        raise exceptions.ParseError("A request needs a body with its Content-Length.")
    if length > most:
        raise TooLarge()
    _charge(request.user, length)


def _charge(user: Any, size: int) -> None:
    """Count bytes by user; who sends too many waits."""
    from django.core.cache import cache

    key = f"{home.NAME}-bytes-{user.pk}"
    cache.add(key, 0, bounds.USER_WINDOW_S)
    try:
        total = cache.incr(key, size)
    except ValueError:
        cache.set(key, size, bounds.USER_WINDOW_S)
        total = size
    if total > bounds.USER_BYTES:
        raise exceptions.Throttled(wait=bounds.USER_WINDOW_S, detail="Too many bytes at once; try again later.")


def project_for(request: Any, value: Any, perm: str) -> Any:
    """The project where this user has ``perm``; it is not told whether it exists otherwise."""
    from app.api.common import get_and_check_project

    if not isinstance(value, int) or isinstance(value, bool):
        raise exceptions.ValidationError({"detail": "project must be a number."})
    return get_and_check_project(request, value, (perm,))
