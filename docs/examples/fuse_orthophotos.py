"""The projects' orthophotos on one grid in one file, and how far they lie apart (needs GDAL).

python docs/examples/fuse_orthophotos.py RESULT FUSED.tif
"""

from __future__ import annotations

import sys
from pathlib import Path

from sensorgate.plugin.fuse import fuse, lines


def main(result: Path, out: Path) -> int:
    """Fuse what ODM left below ``result``; 1 where something was left out or lies apart."""
    fusion = fuse([result], out)
    print("\n".join(lines(fusion)))
    return 1 if fusion.findings else 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), Path(sys.argv[2])))
