"""Who has no permission on a project is told that there is none."""

from rest_framework import exceptions

from app.models import Project


def check_project_perms(request, project, perms=("view_project",)):
    if not all(request.user.has_perm(p, project) for p in perms):
        raise exceptions.NotFound()


def get_and_check_project(request, project_pk, perms=("view_project",)):
    project = Project.objects.filter(pk=project_pk, deleting=False).first()
    if project is None:
        raise exceptions.NotFound()
    check_project_perms(request, project, perms)
    return project
