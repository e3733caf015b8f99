#!/bin/sh
# What NodeODM starts in place of ODM's run.sh: sensorgate looks at the task first, then ODM runs.
# SENSORGATE_ODM names ODM's folder where it is neither the one noted here nor /code.
here=$(CDPATH='' cd -- "$(dirname -- "$0")" && pwd)
odm=${SENSORGATE_ODM:-}
[ -n "$odm" ] || odm=$(cat "$here/ODM_HOME" 2>/dev/null)
[ -f "$odm/run.sh" ] || odm=/code
if [ ! -f "$odm/run.sh" ]; then
    echo "[ERROR]   ODM is not in $(cat "$here/ODM_HOME" 2>/dev/null) and not in /code. Name its folder in SENSORGATE_ODM."
    exit 3
fi
SENSORGATE_ODM=$odm
export SENSORGATE_ODM
python=python3
[ -x "$odm/venv/bin/python3" ] && python=$odm/venv/bin/python3
if [ -d "$odm/SuperBuild/install/lib" ]; then
    LD_LIBRARY_PATH=${LD_LIBRARY_PATH:+$LD_LIBRARY_PATH:}$odm/SuperBuild/install/lib
    export LD_LIBRARY_PATH
fi
exec "$python" "$here/start.py" "$@"
