"""Permissions on single projects."""

from app.models import Grant


class ProjectBackend:
    def authenticate(self, request, **_):
        return None

    def has_perm(self, user, perm, obj=None):
        if obj is None or not user.is_active or user.is_anonymous:
            return False
        return user.is_superuser or Grant.objects.filter(user=user, project=obj, perm=perm).exists()
