#!/bin/sh
# Makes .venv from the hashed lock file, with the three members installed editable. Quick when nothing changed.
set -eu
python=${PYTHON:-python3.11}
command -v "$python" >/dev/null 2>&1 || python=python3
"$python" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' 2>/dev/null || {
    echo "farfield needs Python 3.11; found $("$python" --version 2>&1). Set PYTHON to one." >&2
    exit 1
}
export UV_PYTHON_DOWNLOADS=never UV_LINK_MODE=copy
uv=.cache/uv/bin/uv
if [ ! -x "$uv" ]; then
    rm -rf .cache/uv
    if ! "$python" -m venv .cache/uv 2>/dev/null; then # Debian keeps ensurepip in a package of its own
        rm -rf .cache/uv
        sh infra/setup/system.sh python3-venv
        "$python" -m venv .cache/uv
    fi
    .cache/uv/bin/pip install --quiet --disable-pip-version-check --require-hashes -r infra/requirements/uv.lock
fi
[ -x .venv/bin/python ] || "$uv" venv --quiet --python "$python" .venv
"$uv" pip sync --quiet --python .venv/bin/python --require-hashes infra/requirements/dev.lock
"$uv" pip install --quiet --python .venv/bin/python --no-deps --require-hashes -r infra/requirements/demo.lock
"$uv" pip install --quiet --python .venv/bin/python --no-deps --no-build-isolation -e services -e api -e workers
