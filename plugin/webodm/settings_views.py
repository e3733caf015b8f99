"""The endpoint for settings."""

from __future__ import annotations

from typing import Any

from rest_framework import exceptions
from rest_framework.response import Response

from . import hold, preferences, presence, records
from .views import Conflict, View, plainly


class SettingsView(View):
    """``settings``."""

    def get(self, request: Any) -> Response:
        """What is set."""
        return Response(preferences.describe(request.user))

    @plainly
    def post(self, request: Any) -> Response:
        """Change some of it."""
        data = self.body()
        scope = data.get("scope", preferences.MINE)
        if ("hold" in data or scope == preferences.ALL) and not request.user.is_superuser:
            raise exceptions.PermissionDenied("Only an administrator may set that for all users.")
        if data.get("hold") == preferences.HOLD and preferences.mode() != preferences.HOLD:
            wanted = presence.restart_needed()
            if wanted:
                raise Conflict(f"Hold cannot be switched on yet. {wanted}")
        store = preferences.store_for(scope, request.user)
        if "thresholds" in data:
            preferences.set_thresholds(store, data["thresholds"])
        if "sheet" in data:
            preferences.set_sheet(store, data["sheet"])
        if "hold" in data:
            preferences.set_mode(data["hold"])
            if data["hold"] != preferences.HOLD:
                _look_at_what_waits()
        return Response(preferences.describe(request.user))


def _look_at_what_waits() -> None:
    """Tasks that were held are let go by the worker's next look at them."""
    for task_id, _ in records.all_in(records.WAITING, records.HELD):
        hold.look_at(task_id)
