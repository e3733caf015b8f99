"""The option list as NodeODM asks for it: ODM's own options, read from ODM itself, and sensorgate's."""

from __future__ import annotations

import importlib
import os
import sys
from typing import Any

_HERE = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))


def _odm_home() -> str:
    noted = os.environ.get("SENSORGATE_ODM", "")
    if not noted:
        with open(os.path.join(_HERE, "ODM_HOME"), encoding="utf-8") as stream:
            noted = stream.read().strip()
    return noted if os.path.isfile(os.path.join(noted, "run.sh")) else "/code"


def config(argv: Any = None, parser: Any = None) -> Any:
    """Add our options to ``parser`` and let ODM add its own."""
    sys.dont_write_bytecode = True
    site = os.path.join(_HERE, "site")
    sys.path.insert(0, site)
    importlib.import_module("sensorgate.plugin.node.options").add_to(parser)
    sys.path.remove(site)
    home = _odm_home()
    package = "opendm" if os.path.isfile(os.path.join(home, "opendm", "config.py")) else "modules"
    for name in [n for n in sys.modules if n.split(".")[0] == package]:
        del sys.modules[name]
    # NodeODM put this folder on the path, where a package of the same name stands: ODM's has to come first.
    sys.path.insert(0, home)
    return importlib.import_module(package + ".config").config(argv, parser)
