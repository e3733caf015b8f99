"""A little WebODM in a folder of its own, with the plugin installed from its archive under an odd name."""

import importlib
import json
import os
import sys
import zipfile
from pathlib import Path

import pytest

FOLDER = "camera-check_2"
HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
MEDIA = Path(os.environ["INSIDE_MEDIA"])


def _set_up():
    import django
    from django.conf import settings

    with zipfile.ZipFile(os.environ["INSIDE_ARCHIVE"]) as archive:
        archive.extractall(MEDIA / "unpacked")
    (MEDIA / "plugins").mkdir()
    (MEDIA / "plugins/__init__.py").write_text("")
    (MEDIA / "unpacked/sensorgate").rename(MEDIA / "plugins" / FOLDER)
    # As if WebODM had been started with the plugin in place.
    os.utime(MEDIA / "plugins" / FOLDER / "__init__.py", (10**9, 10**9))
    (MEDIA / "tmp").mkdir()
    sys.path.append(str(MEDIA))
    settings.configure(
        SECRET_KEY="x",
        MEDIA_ROOT=str(MEDIA),
        MEDIA_TMP=str(MEDIA / "tmp"),
        ALLOWED_HOSTS=["*"],
        ROOT_URLCONF="urls",
        DATABASES={"default": {"ENGINE": "django.db.backends.sqlite3", "NAME": ":memory:"}},
        AUTHENTICATION_BACKENDS=["django.contrib.auth.backends.ModelBackend", "app.backends.ProjectBackend"],
        INSTALLED_APPS=[
            "django.contrib.auth",
            "django.contrib.contenttypes",
            "django.contrib.sessions",
            "rest_framework",
            "app",
            "nodeodm",
        ],
        MIDDLEWARE=[
            "django.contrib.sessions.middleware.SessionMiddleware",
            "django.middleware.csrf.CsrfViewMiddleware",
            "django.contrib.auth.middleware.AuthenticationMiddleware",
        ],
        REST_FRAMEWORK={"DEFAULT_AUTHENTICATION_CLASSES": ["rest_framework.authentication.SessionAuthentication"]},
        TEMPLATES=[{"BACKEND": "django.template.backends.django.DjangoTemplates", "DIRS": [str(HERE), str(MEDIA)]}],
    )
    django.setup()
    from django.core.management import call_command

    call_command("migrate", run_syncdb=True, verbosity=0)
    from app.plugins import load

    load(FOLDER)


_set_up()


@pytest.fixture(autouse=True)
def clean(monkeypatch):
    presence = importlib.import_module(f"plugins.{FOLDER}.plugin.webodm.presence")
    with monkeypatch.context() as worker:
        worker.setattr("sys.argv", ["/usr/bin/celery"])
        presence.note()
    yield
    from app.models import Plugin, PluginDatum, Task
    from app.plugins import worker
    from django.contrib.auth.models import User
    from django.core.cache import cache
    from nodeodm.models import ProcessingNode
    from worker import tasks

    PluginDatum.objects.all().delete()
    Task.objects.all().delete()
    ProcessingNode.objects.all().delete()
    User.objects.all().delete()
    Plugin.objects.all().update(enabled=True)
    cache.clear()
    worker.waiting.clear()
    tasks.processed.clear()


@pytest.fixture
def frames():
    """Camera -> its files, as the outer test made them."""
    return {k: [Path(p) for p in v] for k, v in json.loads(os.environ["INSIDE_FRAMES"]).items()}
