"""WebODM hands the worker a function's source; here it waits until the test lets the worker run."""

import inspect
import json

waiting = []


def run_function_async(func, *args):
    waiting.append((inspect.getsource(func), func.__name__, json.loads(json.dumps(args))))


def work():
    while waiting:
        source, name, args = waiting.pop(0)
        names = {}
        exec(compile(source, "file", "exec"), names, names)
        assert isinstance(names[name](*args), dict)
