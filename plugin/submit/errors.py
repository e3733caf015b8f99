"""What can go wrong between us and a node, sorted by what may be done about it."""

from __future__ import annotations

from ...stages.errors import SensorgateError


class NodeError(SensorgateError):
    """Something about the node or the way to it."""

    exit_code = 3


class NodeUnusable(NodeError):
    """The node cannot be worked with: wrong token, not a node, no option list. Asking again changes nothing."""


class NotSent(NodeError):
    """The connection was never made, so nothing has arrived. Asking again is safe."""


class Unsure(NodeError):
    """No answer, or one that says nothing: the request may have been carried out or not."""


class Refused(NodeError):
    """The node answered, and its answer is no."""

    def __init__(self, message: str, text: str) -> None:
        super().__init__(message)
        self.text = text


class NodeFull(NodeError):
    """The node's disk is full."""


class Abandoned(NodeError):
    """This upload cannot be brought to an end; a new one has to be begun."""
