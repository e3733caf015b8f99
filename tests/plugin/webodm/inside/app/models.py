"""As much of WebODM's models as the plugin touches."""

import json
import os
import uuid

from django.conf import settings
from django.contrib.auth.models import User
from django.db import models
from nodeodm.models import ProcessingNode


class JSONField(models.TextField):
    def from_db_value(self, value, *_):
        return None if value is None else json.loads(value)

    def get_prep_value(self, value):
        return None if value is None else json.dumps(value)


class Plugin(models.Model):
    name = models.CharField(max_length=255, primary_key=True)
    enabled = models.BooleanField(default=True)


class PluginDatum(models.Model):
    key = models.CharField(max_length=255)
    user = models.ForeignKey(User, null=True, on_delete=models.CASCADE)
    string_value = models.TextField(null=True)
    json_value = JSONField(null=True)


class Project(models.Model):
    name = models.CharField(max_length=255)
    owner = models.ForeignKey(User, on_delete=models.CASCADE)
    public = models.BooleanField(default=False)
    deleting = models.BooleanField(default=False)


class Grant(models.Model):
    user = models.ForeignKey(User, on_delete=models.CASCADE)
    project = models.ForeignKey(Project, on_delete=models.CASCADE)
    perm = models.CharField(max_length=50)


class _Console:
    def __init__(self, path):
        self.path = path

    def output(self):
        return open(self.path).read() if os.path.isfile(self.path) else ""


class Task(models.Model):
    id = models.UUIDField(primary_key=True, default=uuid.uuid4)
    uuid = models.CharField(max_length=255, default="")
    project = models.ForeignKey(Project, on_delete=models.CASCADE)
    name = models.CharField(max_length=255, null=True)
    processing_node = models.ForeignKey(ProcessingNode, on_delete=models.SET_NULL, null=True)
    auto_processing_node = models.BooleanField(default=True)
    status = models.IntegerField(null=True)
    last_error = models.TextField(null=True)
    options = JSONField(default=list)
    available_assets = JSONField(default=list)
    pending_action = models.IntegerField(null=True)
    public = models.BooleanField(default=False)
    resize_to = models.IntegerField(default=-1)
    import_url = models.TextField(default="")
    images_count = models.IntegerField(default=0)
    partial = models.BooleanField(default=False)
    compacted = models.BooleanField(default=False)
    tags = models.TextField(default="")
    created_at = models.DateTimeField(auto_now_add=True)

    @property
    def console(self):
        return _Console(self.data_path("console_output.txt"))

    def save(self, *args, **kwargs):
        for option in self.options or []:
            assert option["name"] and option["value"], "Invalid options"
        super().save(*args, **kwargs)

    def task_path(self, *parts):
        return os.path.join(settings.MEDIA_ROOT, "project", str(self.project_id), "task", str(self.id), *parts)

    def data_path(self, *parts):
        return self.task_path("data", *parts)

    def assets_path(self, *parts):
        return self.task_path("assets", *parts)

    def create_task_directories(self):
        os.makedirs(self.assets_path(), exist_ok=True)

    def scan_images(self):
        if not os.path.isdir(self.task_path()):
            return []
        return [e.name for e in os.scandir(self.task_path()) if e.is_file()]

    def update_size(self):
        pass

    def set_alignment_file_from(self, other):
        os.link(other.assets_path("model.laz"), self.task_path("align.laz"))
