import json

from django.db import models


class _Options(models.TextField):
    def from_db_value(self, value, *_):
        return json.loads(value)

    def get_prep_value(self, value):
        return json.dumps(value)


class ProcessingNode(models.Model):
    hostname = models.CharField(max_length=255)
    queue_count = models.IntegerField(default=0)
    available_options = _Options(default=list)

    def __str__(self):
        return self.hostname

    def is_online(self):
        return True
