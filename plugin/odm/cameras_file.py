"""What ODM would make of a cameras file: keys that match no frame, fields that it leaves out (pure)."""

from __future__ import annotations

from typing import Any, List, Sequence, Tuple

from ...stages.finding import ERROR, WARNING, Finding, sort_key
from .camera_id import file_key

_FIELDS = frozenset(
    [
        "id",
        "projection_type",
        "width",
        "height",
        "focal",
        "focal_x",
        "focal_y",
        "c_x",
        "c_y",
        "k1",
        "k2",
        "p1",
        "p2",
        "k3",
    ]
)


def check_cameras_file(cameras: Any, ids: Sequence[str]) -> Tuple[Finding, ...]:
    """What ODM would do with a cameras file (parsed JSON) beside frames of these ids.

    ODM ignores the whole file on one bad key, ignores unknown fields, and
    takes an entry that matches no frame without a word.
    """
    if not isinstance(cameras, dict):
        return (
            _bad_file("Expected an object with one entry per camera.", "Invalid cameras format: %s. Expected dict."),
        )
    findings: List[Finding] = []
    known = {file_key(i) for i in ids}
    for key in sorted(cameras):
        value = cameras[key]
        if len(key.split(" ")) < 6 or not isinstance(value, dict):
            findings.append(_bad_file(f"The key {key!r} is no camera id.", f"Invalid cameraID: {key}", (key,)))
            continue
        if file_key(key) not in known:
            findings.append(
                Finding(
                    code="odm-camera-key-unmatched",
                    severity=ERROR,
                    subjects=(key,),
                    message=f"No frame of the project has the camera id {key!r}; ODM would ignore this calibration "
                    "without a word.",
                    remedy=f"Use the id that ODM computes: {', '.join(sorted(known)) or 'none, no frame is usable'}.",
                )
            )
        for name in sorted(value):
            if name not in _FIELDS and not name.endswith("_prior"):
                findings.append(
                    Finding(
                        code="odm-camera-field-ignored",
                        severity=WARNING,
                        subjects=(key,),
                        message=f"ODM does not know the field {name!r} of a camera and leaves it out.",
                        remedy="Convert it to Brown's model: focal_x, focal_y, c_x, c_y, k1, k2, p1, p2, k3.",
                        odm_message=f"Invalid camera key ignored: {name}",
                    )
                )
    return tuple(sorted(findings, key=sort_key))


def _bad_file(message: str, odm_message: str, subjects: Tuple[str, ...] = ("cameras",)) -> Finding:
    return Finding(
        code="odm-cameras-file-invalid",
        severity=ERROR,
        subjects=subjects,
        message=f"{message} ODM would go on without any calibration.",
        remedy="Write the file as ODM's cameras.json: one object per camera id.",
        odm_message=f"Cannot set camera_models_overrides.json: {odm_message}",
    )
