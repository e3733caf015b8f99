"""A small stand-in for an ODM: its run script, its option parser, and the files that it leaves."""

from __future__ import annotations

import json
import os
import stat
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, List, Optional

from sensorgate.plugin.node.folder import write_folder

ROOT = Path(__file__).resolve().parents[3]

_RUN_SH = """\
#!/bin/sh
here=$(cd "$(dirname "$0")" && pwd)
{python} "$here/run.py" "$@"
"""

# Written as ODM's parser is: actions of its own, one group of which one option may stand, defaults that help shows.
_CONFIG = """\
import argparse
import os

from opendm import context

STAGES = ["dataset", "opensfm", "odm_orthophoto", "odm_report"]


class Keep(argparse.Action):
    def __call__(self, parser, namespace, values, option_string=None):
        setattr(namespace, self.dest, values)


class KeepTrue(argparse.Action):
    def __call__(self, parser, namespace, values, option_string=None):
        setattr(namespace, self.dest, True)


def config(argv=None, parser=None):
    if parser is None:
        parser = argparse.ArgumentParser()
    parser.add_argument("--project-path", metavar="<path>", action=Keep, help="where projects are")
    parser.add_argument("name", metavar="<dataset name>", action=Keep, type=str, default="code", nargs="?")
    parser.add_argument("--end-with", "-e", metavar="<string>", action=Keep, choices=STAGES, default="odm_report")
    again = parser.add_mutually_exclusive_group()
    again.add_argument("--rerun-from", action=Keep, metavar="<string>", choices=STAGES, help="from there")
    parser.add_argument("--dsm", action=KeepTrue, nargs=0, default=False, help="surface. Default: %(default)s")
    parser.add_argument("--cameras", default="", metavar="<json>", action=Keep, type=str, help="cameras")
    parser.add_argument("--camera-lens", default="auto", choices=["auto", "brown"], action=Keep)
    parser.add_argument("--gps-accuracy", type=float, action=Keep, metavar="<positive float>", default=3)
    parser.add_argument("--use-fixed-camera-params", action=KeepTrue, nargs=0, default=False)
    parser.add_argument("--use-exif", action=KeepTrue, nargs=0, default=False)
    parser.add_argument("--gcp", metavar="<path string>", action=Keep, default=None)
    parser.add_argument("--geo", metavar="<path string>", action=Keep, default=None)
    parser.add_argument("--split-image-groups", metavar="<path string>", action=Keep, default=None)
    args, unknown = parser.parse_known_args(argv)
    if unknown:
        parser.error("unrecognized arguments: " + " ".join(unknown))
    return args
"""

_RUN_PY = """\
import json, os, signal, socket, sys, time, datetime

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from opendm import config

args = config.config()
assert open("VERSION").read().startswith("3.6"), "the working folder is not ODM's"
root = os.path.join(args.project_path, args.name)
calls = os.environ["FAKE_ODM_CALLS"]
images = sorted(n for n in os.listdir(os.path.join(root, "images")) if n.lower().endswith((".jpg", ".tif")))
with open(calls, "a") as stream:
    stream.write(json.dumps({
        "argv": sys.argv[1:], "images": images, "root": root, "pid": os.getpid(),
        "found": sorted(os.listdir(root)), "pythonpath": os.environ.get("PYTHONPATH"),
    }) + "\\n")


def stop(number, frame):
    with open(calls + ".stopped", "a") as stream:
        stream.write(str(os.getpid()) + "\\n")
    os._exit(1)


signal.signal(signal.SIGTERM, stop)
out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
port = int(os.environ.get("FAKE_ODM_PORT", "6367"))
began = datetime.datetime.now().isoformat()
stages = []


def write(name, text="made by ODM"):
    path = os.path.join(root, name)
    os.makedirs(os.path.dirname(path), exist_ok=True)
    with open(path, "w") as stream:
        stream.write(text)


for name, percent in (("dataset", 5), ("opensfm", 25), ("odm_orthophoto", 98), ("odm_report", 99)):
    print("\\x1b[39m[INFO]    Running %s stage\\x1b[39m" % name, flush=True)
    stages.append({"name": name, "startTime": datetime.datetime.now().isoformat(), "messages": []})
    if name == os.environ.get("FAKE_ODM_HANG"):
        time.sleep(60)
    if name == os.environ.get("FAKE_ODM_FAIL") and os.environ.get("FAKE_ODM_FAIL_ON", "") in root:
        sys.exit(int(os.environ.get("FAKE_ODM_CODE", "1")))
    if name == "opensfm":
        write("opensfm/reconstruction.json", "[]")
        write("opensfm/camera_models.json", "{}")
        write("images.json", json.dumps(images))
    if name == "odm_orthophoto":
        write("odm_orthophoto/odm_orthophoto.tif", " ".join(images))
    if name == "odm_report":
        write("odm_report/stats.json", "{}")
    print("\\x1b[39m[INFO]    Finished %s stage\\x1b[39m" % name, flush=True)
    out.sendto(("PGUP/%s/%s/%s" % (os.getpid(), args.name, float(percent))).encode(), ("127.0.0.1", port))
    if name == args.end_with:
        break
ended = datetime.datetime.now().isoformat()
write("log.json", json.dumps({
    "odmVersion": "3.6.0", "images": len(images), "startTime": began, "endTime": ended, "totalTime": 0.1,
    "stages": stages, "processes": [], "success": True,
}))
"""


def make_odm(folder: Path) -> Path:
    """Write the stand-in below ``folder`` and return its path."""
    odm = folder / "ODM"
    (odm / "opendm").mkdir(parents=True)
    (odm / "VERSION").write_text("3.6.0\n")
    (odm / "run.sh").write_text(_RUN_SH.format(python=sys.executable))
    (odm / "run.sh").chmod(0o755)
    (odm / "run.py").write_text(_RUN_PY)
    (odm / "opendm/__init__.py").write_text("")
    (odm / "opendm/context.py").write_text("root = __file__\n")
    (odm / "opendm/config.py").write_text(_CONFIG)
    return odm


def no_wheels(folder: Path) -> Path:
    """An empty folder of wheels: nothing is fetched, all libraries are those that are here."""
    wheels = folder / "wheels"
    wheels.mkdir(exist_ok=True)
    return wheels


@dataclass
class Node:
    """The stand-in with the folder in front of it, and the tasks of one node."""

    odm: Path
    front: Path
    data: Path
    env: Dict[str, str]

    @property
    def calls_file(self) -> Path:
        return self.data / "calls.jsonl"

    def calls(self) -> List[Dict[str, object]]:
        """What the stand-in was called with, in order."""
        if not self.calls_file.exists():
            return []
        return [json.loads(line) for line in self.calls_file.read_text().splitlines()]

    def command(self, name: str, *options: str) -> List[str]:
        """As NodeODM calls it."""
        return [str(self.front / "run.sh"), *options, "--project-path", str(self.data), name]

    def run(self, name: str, *options: str, **env: str) -> "subprocess.CompletedProcess[str]":
        """Run one task to its end."""
        return subprocess.run(
            self.command(name, *options),
            cwd=self.front,
            env={**self.env, **env},
            capture_output=True,
            text=True,
            timeout=300,
        )

    def task(self, name: str) -> Path:
        """A task's folder."""
        return self.data / name


def make_node(folder: Path, port: Optional[int] = None) -> Node:
    """The stand-in, the folder in front of it, and an empty data folder."""
    odm = make_odm(folder)
    front = folder / "front"
    write_folder(odm, front, wheels=no_wheels(folder))
    data = folder / "data"
    data.mkdir()
    # The launcher takes ODM's own Python; here that is this one.
    (odm / "venv/bin").mkdir(parents=True)
    python = odm / "venv/bin/python3"
    python.write_text(f'#!/bin/sh\nexec {sys.executable} "$@"\n')
    python.chmod(python.stat().st_mode | stat.S_IXUSR)
    env = {**os.environ, "FAKE_ODM_CALLS": str(data / "calls.jsonl"), "ODM_NONINTERACTIVE": "1"}
    env.pop("PYTHONPATH", None)
    if port is not None:
        env["FAKE_ODM_PORT"] = str(port)
    return Node(odm, front, data, env)
