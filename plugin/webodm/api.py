"""The plugin's API below ``/api/plugins/<name>/``.

Every answer is JSON; an error is ``{"detail": "<sentence for the user>"}`` with
400 (malformed), 403 (no CSRF token, or not allowed), 404 (not there, or not
yours: the two are not told apart), 409 (the state does not allow it), 413 (a
bound was exceeded) or 429 (more bytes than allowed for now; header
``Retry-After``, in seconds). All mutating requests need a logged-in user and
``X-CSRFToken``; bodies are ``application/json``.

Before the upload
=================

``POST sessions`` ``{"project": 7}`` -> 201::

    {"session": "<32 hex>",            # belongs to the user; gone after a day
     "limits": {"head_bytes": 65536,   # send at least this much from offset 0, or the header segments up to the scan
                "batch_files": 64, "batch_bytes": 4194304,       # per request: files, and characters of base64
                "file_bytes": 1048576, "files": 20000,           # per file: header bytes; per session: files
                "control_bytes": 4194304},
     "hold": "off" | "report" | "hold", "may_override": false}

Needs ``change_project`` on the project.

``POST sessions/<session>/headers``::

    {"files": [{"id": 0,                                  # the caller's number of the file, unique in the session
                "path": "DCIM/100MEDIA/DJI_0001.JPG",     # name, with its folder where the browser knows it
                "size": 10485760, "modified": 1716200000000,
                "ranges": [[0, "<base64>"], [9000000, "<base64>"]]}]}   # [offset, bytes]

    -> {"read": 63, "files": 63,                          # read from this batch; of the session so far
        "need": [{"id": 5, "offset": 9000000, "length": 4096}],
        "broken": [{"id": 8, "path": "...", "message": "The file has no bytes: ..."}],
        "cameras": [{"name": "DJI FC6310", "width": 5472, "height": 3648, "frames": 40}],   # in this batch
        "ignored": 0}

``need`` names the next bytes without which a file cannot be read: send the
file again with **all** its ranges, that one added (nothing is kept of a file
that could not be read). Masks (``*_mask.png`` and so on) are sent with ``ranges: []``, so that they
get their image's new name. Batches may be sent in parallel and in any order; a file sent twice counts once,
the later one. Files that are no images (videos, logs) are not sent here.

``POST sessions/<session>/control`` ``{"kind": "gcp" | "geo", "text": "..."}`` -> ``{"ok": true}``:
ground control or positions that the user chose along. An empty text takes it back.

``GET sessions/<session>/verdict``, or ``POST`` with the user's choices::

    {"off": ["options"],                        # rules that were unticked
     "moves": {"<payload id>": "<task key>"}}   # payloads that were put elsewhere ("" = not sent)

    -> {"files": 1000,                          # read so far: the verdict may be asked for while reading goes on
        "verdict": "consistent" | "inconsistent" | "blocked",
        "headline": "3 cameras that do not belong in one task",
        "cameras": [{"id": "dji-fc6310", "camera": "DJI FC6310", "name": "DJI FC6310", "spectrum": "rgb", "band": "",
                     "width": 5472, "height": 3648, "focal_mm": 8.8, "frames": 500, "payload": "dji-fc6310"}],
        "payloads": [{"id": "...", "name": "...", "spectrum": "...", "bands": ["green", "nir"], "frames": 500,
                      "task": "rgb"}],
        "findings": [{"code": "...", "severity": "error" | "warning" | "info", "message": "...", "remedy": "...",
                      "files": 12}],
        "odm": ["ODM would use 900 of 1000 frames.", "..."],        # this folder as it is, in words
        "ours": ["Two tasks: ...", "..."],                          # what we would do instead, in words
        "rules": [{"id": "split", "text": "...", "on": true, "frames": 100}],
        "tasks": [{"key": "rgb", "name": "rgb",                     # put behind the name that the user gives
                   "spectrum": "rgb", "payloads": ["..."], "frames": 500,
                   "files": [[0, "DJI_0001.JPG"], [17, "zenmuse_DJI_0001.JPG"]],     # [id, name to upload it under]
                   "options": [{"name": "gps-accuracy", "value": 0.05}],
                   "reasons": {"gps-accuracy": "all frames have this accuracy and ODM would take 10 m"},
                   "tags": ["sensorgate", "rgb"],
                   "texts": {"gcp_list.txt": "...", "geo.txt": "..."}}],             # to be uploaded as files
        "left_out": [{"id": 8, "path": "...", "reason": "panel", "message": "..."}],
        "report": "/plugins/<name>/sessions/<session>/report",
        "engine": "node" | "worker" | "gate", "engine_message": "..."}   # where harmonizing would run

Rules are ``split``, ``leave-out``, ``options`` and ``control``. ``options``
holds no false flag (WebODM refuses falsy values) and is meant to be laid over
the user's own. Without any readable file: 409.

``POST sessions/<session>/claim`` ``{"task": "<uuid>", "key": "rgb", "off": [...], "moves": {...}}``
-> ``{"ok": true, "honoured": bool, "message": "..."}``:
after a proposed task was created (partial) and before it is committed, so that
hold mode knows the user's choices and the task gets its report page. It does not
let a task past the gate: hold mode looks at what was really uploaded, and keeps
together what it would part only where the files are the chosen ones and this user
may let tasks go (``may_override``); else ``message`` says that it will not.

A task
======

``GET projects/<project>/tasks/<task>/state`` (needs ``view_project``; public tasks too) ::

    {"state": "none" | "waiting" | "checking" | "released" | "held" | "split" | "overridden" | "working" | "failed",
     "message": "Waiting until its cameras have been checked.",    # why, and what to do
     "progress": 0.4,                                              # of work under way, else null
     "verdict": "inconsistent" | null, "report": "/plugins/<name>/tasks/<task>/report" | null,
     "actions": ["check", "override", "split", "judge", "prepare"],   # what this user may do now
     "tasks": [{"id": "...", "project": 7, "name": "..."}],        # that came of it
     "engine": "node" | "worker" | "gate", "engine_message": "..."}

``GET waiting?projects=7,8`` -> ``{"projects": {"7": [{"id", "name", "state", "message", "progress"}]}}``: the tasks
of at most 100 projects that wait for the gate or are worked on, and those whose upload broke off (``broken-off``);
projects without any, and those that this user may not see, are left out.

``POST projects/<project>/tasks/<task>/<action>`` with an action out of
``actions`` (needs ``change_project``; ``override`` also the permission
``app.override_sensorgate_hold``) -> the new state:

``check``     look at its images (again), in the worker
``override``  let a held task go as it is
``split``     create the proposed tasks from its images: ``{"align": true}`` lays them on the anchor's result
``judge``     the router's verdict on a failed or finished task; then ``state`` has ``"judgement":
              {"route": "pairwise", "reasons": ["..."], "tasks": [{"name", "frames", "options"}],
              "anchor": {"id", "name"} | null}``, and ``split`` creates these
``prepare``   harmonize and align in WebODM's worker, then create the projects as tasks

Settings
========

``GET settings`` -> ``{"hold": ..., "may_change": bool, "restart": "Restart WebODM now ..." | "",
"thresholds": {"mine": {}, "all": {}, "known": {name:
{"default", "unit", "why"}}}, "sheet": {"mine": "name.csv" | null, "all": null, "rows": 3}, "extras": [{"name",
"needed_for", "installed", "message"}]}``.

``POST settings`` with any of ``{"hold": "report", "thresholds": {"focal_variance": 0.05}, "sheet": {"name": "mine.csv",
"text": "..."}, "scope": "mine" | "all"}``; ``scope`` ``all`` and ``hold`` need an administrator. ``thresholds`` are
all changes (what is missing returns to its default), ``sheet: null`` removes the sheet.
"""

from __future__ import annotations

from . import state
from .session_views import Claim, ControlText, Headers, NewSession, Verdict
from .settings_views import SettingsView
from .task_views import TaskAction, TaskState, Waiting

ROUTES = (
    (r"sessions$", NewSession),
    (r"sessions/(?P<session>[0-9a-f]{32})/headers$", Headers),
    (r"sessions/(?P<session>[0-9a-f]{32})/control$", ControlText),
    (r"sessions/(?P<session>[0-9a-f]{32})/verdict$", Verdict),
    (r"sessions/(?P<session>[0-9a-f]{32})/claim$", Claim),
    (r"projects/(?P<project>[0-9]+)/tasks/(?P<task>[0-9a-f-]{36})/state$", TaskState),
    (
        r"projects/(?P<project>[0-9]+)/tasks/(?P<task>[0-9a-f-]{36})/(?P<action>" + "|".join(state.ACTIONS) + r")$",
        TaskAction,
    ),
    (r"waiting$", Waiting),
    (r"settings$", SettingsView),
)
