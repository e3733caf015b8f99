from __future__ import annotations

import pytest

from tests.simulator import render


@pytest.fixture(scope="session")
def tiny(tmp_path_factory):
    pytest.importorskip("cv2", reason="frames are rendered with OpenCV")
    return render("tiny", tmp_path_factory.mktemp("tiny"))
