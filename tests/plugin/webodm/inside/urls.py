"""The plugin's addresses where WebODM would put them."""

from app.plugins import loaded
from django.conf.urls import url


def _patterns():
    for plugin in loaded.values():
        for point in plugin.api_mount_points():
            yield url(f"^api/plugins/{plugin.name}/{point.url}", point.view)
        for point in plugin.app_mount_points():
            yield url(f"^plugins/{plugin.name}/{point.url}", point.view)
    yield url("^accounts/login/$", lambda request: None)


urlpatterns = list(_patterns())
