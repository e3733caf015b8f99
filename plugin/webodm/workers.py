"""Work that WebODM's worker does. It gets the source of the functions here and runs them with nothing around."""

from __future__ import annotations

from typing import Any

from . import home


def run_check(package, task_id):  # type: ignore[no-untyped-def]
    """Runs in the worker."""
    import importlib

    return importlib.import_module(package + ".plugin.webodm.checking").check_task(task_id)


def run_prepare(package, task_id, user_id):  # type: ignore[no-untyped-def]
    """Runs in the worker."""
    import importlib

    return importlib.import_module(package + ".plugin.webodm.preparing").prepare_task(task_id, user_id)


def check(task_id: Any) -> None:
    """Have the worker look at a task."""
    from app.plugins.worker import run_function_async

    run_function_async(run_check, home.PACKAGE, str(task_id))


def prepare(task_id: Any, user_id: int) -> None:
    """Have the worker harmonize and align a task's images and create the tasks that come out."""
    from app.plugins.worker import run_function_async

    run_function_async(run_prepare, home.PACKAGE, str(task_id), user_id)
