"""The class that WebODM looks for."""

from __future__ import annotations

import logging
import os
from typing import Any, List

from app.plugins import Menu, MountPoint, PluginBase

from . import api, hold, home, pages

LOG = logging.getLogger("app.logger")
_PUBLIC = ("public", "templates")


class Plugin(PluginBase):  # type: ignore[misc]
    """WebODM takes a plugin's name and folder from the module of its class; ours lies deeper, so they are said here."""

    def __init__(self) -> None:
        super().__init__()
        self.name = home.NAME

    def get_path(self, *paths: str) -> str:
        """A path in the plugin; ``public`` and ``templates`` lie beside this module."""
        first = paths[0].replace("\\", "/").split("/")[0] if paths else ""
        return os.path.join(home.HERE if first in _PUBLIC else home.ROOT, *paths)

    def template_path(self, path: str) -> str:
        """The name of a template as WebODM's loaders know it."""
        return f"{home.PACKAGE.split('.')[0]}/{self.name}/plugin/webodm/templates/{path}"

    def register(self) -> None:
        """Called once at WebODM's start, in one of its processes, and when the plugin is switched on."""
        super().register()
        try:
            home.ensure_permission()
        except Exception as error:
            # The web interface works without; only administrators can override until the next start.
            LOG.warning("sensorgate: the permission could not be created: %s", error)

    def main_menu(self) -> List[Any]:
        """The entry in the menu."""
        return [Menu("Camera check", self.public_url(""), "fa fa-camera fa-fw")]

    def include_js_files(self) -> List[str]:
        """Fetches the rest where it is needed."""
        return [f"main.js?v={home.version()}"]

    def include_css_files(self) -> List[str]:
        """The look of what is added."""
        return [f"main.css?v={home.version()}"]

    def app_mount_points(self) -> List[Any]:
        """The pages."""
        return [MountPoint(pattern, pages.for_users(self, view)) for pattern, view in pages.ROUTES]

    def api_mount_points(self) -> List[Any]:
        """The API."""
        return [MountPoint(pattern, view.as_view()) for pattern, view in api.ROUTES]


# Only one of the web processes registers plugins, but each one loads them before its first request.
hold.connect()
