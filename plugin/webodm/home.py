"""Where the plugin stands inside WebODM: its name, folders and stores. Imports Django and WebODM."""

from __future__ import annotations

import contextlib
import sys
from os.path import abspath, basename, dirname, join
from pathlib import Path
from typing import Any, Iterator, Optional

HERE = dirname(abspath(__file__))
ROOT = dirname(dirname(HERE))
NAME = basename(ROOT)
# plugins.<dir> or coreplugins.<dir>
PACKAGE = __package__.rpartition(".plugin.")[0]
OVERRIDE = "override_sensorgate_hold"


def plugin() -> Any:
    """The plugin where it is enabled, else ``None``."""
    from app.plugins import get_plugin_by_name

    return get_plugin_by_name(NAME)


def global_store() -> Any:
    """What is kept for all users. Works while the plugin is disabled as well."""
    from app.plugins import GlobalDataStore

    return GlobalDataStore(NAME)


def user_store(user: Any) -> Any:
    """What is kept for one user."""
    from app.plugins import UserDataStore

    return UserDataStore(NAME, user)


def temporary() -> Path:
    """WebODM's own folder of temporary files; its worker removes what is older than a day."""
    from django.conf import settings

    return Path(settings.MEDIA_TMP)


def task_folder(task: Any) -> Path:
    """What we keep of a task: it moves and goes with the task, and is no image."""
    return Path(task.data_path("sensorgate"))


def page(path: str) -> str:
    """The address of one of our pages."""
    return f"/plugins/{NAME}/{path}"


def may_override(user: Any) -> bool:
    """Whether this user may let a held task go."""
    return bool(user.has_perm(f"app.{OVERRIDE}"))


def ensure_permission() -> None:
    """Create the permission, so that an administrator finds it at users and groups."""
    from app.models import Plugin
    from django.contrib.auth.models import Permission
    from django.contrib.contenttypes.models import ContentType

    Permission.objects.get_or_create(
        codename=OVERRIDE,
        content_type=ContentType.objects.get_for_model(Plugin),
        defaults={"name": "Can let tasks go that sensorgate holds"},
    )


def packages_folder() -> str:
    """Where WebODM itself puts what a plugin needs."""
    return join(ROOT, "site-packages")


@contextlib.contextmanager
def packages() -> Iterator[None]:
    """What was put into that folder can be imported meanwhile; WebODM's own packages come first."""
    folder = packages_folder()
    sys.path.append(folder)
    try:
        yield
    finally:
        sys.path.remove(folder)


def find_task(task_id: Any) -> Optional[Any]:
    """The task, or ``None``."""
    from app.models import Task
    from django.core.exceptions import ObjectDoesNotExist, ValidationError

    try:
        return Task.objects.select_related("project").get(pk=task_id)
    except (ObjectDoesNotExist, ValidationError, ValueError):
        return None


def version() -> str:
    """The plugin's version, for addresses of files that browsers keep."""
    from ..version import VERSION

    return VERSION
