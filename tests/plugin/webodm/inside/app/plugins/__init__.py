"""As much of WebODM's plugin loader as the plugin touches."""

import importlib

from app.models import Plugin as Row
from app.models import PluginDatum


class Menu:
    def __init__(self, label, link, css):
        self.label, self.link, self.css = label, link, css


class MountPoint:
    def __init__(self, url, view):
        self.url, self.view = url, view


class PluginBase:
    def __init__(self):
        self.name = type(self).__module__.split(".")[-2]

    def register(self):
        pass

    def public_url(self, path):
        return f"/plugins/{self.name}/{path}"


class GlobalDataStore:
    user = None

    def __init__(self, namespace):
        self.namespace = namespace

    def _row(self, key):
        return PluginDatum.objects.filter(key=f"{self.namespace}::{key}", user=self.user).first()

    def _set(self, kind, key, value):
        PluginDatum.objects.update_or_create(
            key=f"{self.namespace}::{key}", user=self.user, defaults={f"{kind}_value": value}
        )

    def get_string(self, key, default=""):
        row = self._row(key)
        return default if row is None else row.string_value

    def get_json(self, key, default=None):
        row = self._row(key)
        return default if row is None else row.json_value

    def set_string(self, key, value):
        self._set("string", key, value)

    def set_json(self, key, value):
        self._set("json", key, value)

    def del_key(self, key):
        row = self._row(key)
        if row is not None:
            row.delete()


class UserDataStore(GlobalDataStore):
    def __init__(self, namespace, user):
        super().__init__(namespace)
        self.user = user


loaded = {}


def load(folder):
    loaded[folder] = importlib.import_module(f"plugins.{folder}").Plugin()
    Row.objects.get_or_create(name=loaded[folder].name)
    loaded[folder].register()
    return loaded[folder]


def get_plugin_by_name(name):
    return next((p for p in loaded.values() if p.name == name and Row.objects.filter(name=name, enabled=True)), None)
