"""Writes what ODM reads beside the images, and what we say about it.

At the project's root only names that ODM reads (``images/``,
``gcp_list.txt``, ``geo.txt``); everything of ours stands in ``sensorgate/``,
because ODM writes ``options.json``, ``cameras.json``, ``images.json`` and
``log.json`` of its own into the root.
"""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any, List, Mapping, Optional, Sequence

from ...stages.errors import UsageError
from ...stages.record import dumps, write_text
from .options import Option, as_node_options

OURS = "sensorgate"
CALIBRATION = f"{OURS}/calibration.json"
# What an earlier ODM run leaves and a later one takes instead of the images.
_RESULTS = ("images.json", "opensfm", "cameras.json")

_SCRIPT = """\
#!/bin/sh
# Runs ODM on this project, from anywhere:
#   odm.sh [docker] [more ODM options]   in a container; ODM_IMAGE names another image
#   odm.sh native [more ODM options]     with an ODM on this machine; ODM_HOME is its folder
{notes}set -eu
project=$(CDPATH='' cd -- "$(dirname -- "$0")/.." && pwd)
how=docker
case "${{1:-}}" in
    docker|native) how=$1; shift ;;
esac
set -- {arguments}"$@"
if [ "$how" = native ]; then
    exec "${{ODM_HOME:-/code}}/run.sh" --project-path "$(dirname -- "$project")" \\
        {native}"$@" "$(basename -- "$project")"
fi
exec docker run --rm -v "$project:/datasets/project" "${{ODM_IMAGE:-opendronemap/odm:latest}}" \\
    --project-path /datasets {docker}"$@" project
"""


def odm_arguments(options: Sequence[Option]) -> List[str]:
    """The options as words of a command line: flags bare, false flags left out."""
    words: List[str] = []
    for option in options:
        if option.value is False:
            continue
        words.append(f"--{option.name}")
        if option.value is not True:
            words.append(str(option.value))
    return words


def odm_script(options: Sequence[Option], *, calibration: bool, notes: Sequence[str] = ()) -> str:
    """The text of ``odm.sh``: docker and native form, every value quoted for the shell."""
    said = [f"# {o.name}: {' '.join(o.reason.split())}\n" for o in options]
    said += [f"# {' '.join(note.split())}\n" for note in notes]
    arguments = "".join(f"{shlex.quote(word)} " for word in odm_arguments(options))
    return _SCRIPT.format(
        notes="".join(said),
        arguments=arguments,
        native=f'--cameras "$project/{CALIBRATION}" ' if calibration else "",
        docker=f"--cameras /datasets/project/{CALIBRATION} " if calibration else "",
    )


def _put(path: Path, text: Optional[str]) -> None:
    """Write ``text``; without it the file goes, so that nothing of an earlier plan is left for ODM to find."""
    if text is not None:
        write_text(path, text)
    elif path.exists():
        path.unlink()


def write_project(
    folder: Path,
    *,
    options: Sequence[Option],
    gcp_text: Optional[str] = None,
    geo_text: Optional[str] = None,
    calibration: Optional[Mapping[str, Any]] = None,
    alignment: Optional[Mapping[str, Any]] = None,
    notes: Sequence[str] = (),
) -> None:
    """Write a sub-project's files into ``folder``, whose ``images/`` already holds its frames.

    ``calibration`` is in ODM's cameras format (``cameras.calibration_for``),
    ``alignment`` a plain JSON object. Raises ``UsageError`` where ``images/``
    is missing or an earlier ODM run left results that ODM would reuse.
    """
    if not (folder / "images").is_dir():
        raise UsageError(f"The project {folder.name} has no images folder; harmonize its frames first.")
    left = [name for name in _RESULTS if (folder / name).exists()]
    if left:
        raise UsageError(
            f"The project {folder.name} holds results of an earlier ODM run ({', '.join(left)}), which ODM would "
            "take instead of the new frames. Choose another output folder or delete the project first."
        )
    _put(folder / "gcp_list.txt", gcp_text)
    _put(folder / "geo.txt", geo_text)
    _put(folder / OURS / "options.json", dumps(as_node_options(options)))
    _put(folder / CALIBRATION, dumps(dict(calibration)) if calibration else None)
    _put(folder / OURS / "alignment.json", dumps(dict(alignment)) if alignment is not None else None)
    script = folder / OURS / "odm.sh"
    _put(script, odm_script(options, calibration=bool(calibration), notes=notes))
    script.chmod(0o755)
