"""The one version: read from ``manifest.json``, one folder up in checkout, wheel and archive."""

import json
import os

with open(
    os.path.join(os.path.dirname(os.path.dirname(os.path.abspath(__file__))), "manifest.json"), encoding="utf-8"
) as _stream:
    VERSION = str(json.load(_stream)["version"])
