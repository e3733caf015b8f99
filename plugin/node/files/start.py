"""Finds what sensorgate needs, in ODM's Python first and in this folder where that lacks it, and starts the task."""

import importlib
import os
import sys

_HERE = os.path.dirname(os.path.abspath(__file__))

sys.dont_write_bytecode = True
sys.path[0] = os.path.join(_HERE, "site")
importlib.import_module("sensorgate.plugin.node.libraries").complete(_HERE, os.environ["SENSORGATE_ODM"])
sys.exit(importlib.import_module("sensorgate.plugin.node.task").main(sys.argv[1:]))
