#!/bin/sh
# Copyright 2026 The hapticvision_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.


# Make .venv from requirements.lock and install this package into it, or say in one sentence what
# is missing. Does nothing when .venv already fits the lock file and the package's metadata.
#
# The environment is never upgraded in place: the ROS wheels share folders, and removing the old
# version of one takes files of its neighbours along.

set -eu

cd -- "$(dirname -- "$0")/.."
venv=$PWD/.venv

# A parent in another ROS environment hands down its library and module paths.
if [ -n "${_ROS_WHEELS_BOOTSTRAP_COMPLETE:-}${AMENT_PREFIX_PATH:-}" ]; then
    unset _ROS_WHEELS_BOOTSTRAP_COMPLETE AMENT_PREFIX_PATH LD_LIBRARY_PATH PYTHONPATH
fi
unset PYTHONHOME VIRTUAL_ENV
HOME=${HOME:-$(getent passwd "$(id -u)" | cut -d: -f6)}
PATH=${PATH:-/usr/local/bin:/usr/bin:/bin}
# uv brings certificates of its own; pip and a company's proxy go by the system's.
export HOME PATH PIP_DISABLE_PIP_VERSION_CHECK=1 UV_SYSTEM_CERTS=true

fail() {
    printf 'setup: %s\n' "$1" >&2
    exit 1
}

# Print the interpreter behind $1 if it runs and is a 64-bit CPython 3.12. Asking is the only
# test: a pyenv shim exists whether or not there is an interpreter behind it.
base_of() {
    "$1" -c '
import platform, sys
fits = sys.version_info[:2] == (3, 12) and sys.maxsize > 2**32
fits = fits and platform.python_implementation() == "CPython"
print(sys._base_executable) if fits else sys.exit(1)' 2>/dev/null
}

find_python() {
    if [ -n "${PYTHON:-}" ]; then
        base_of "$PYTHON" || fail "PYTHON=$PYTHON is not a Python 3.12 that runs."
        return
    fi
    for candidate in python3.12 python3 \
        "${PYENV_ROOT:-$HOME/.pyenv}"/versions/3.12*/bin/python3.12 \
        "$(uv_run python find --no-project 3.12 2>/dev/null)" \
        "${UV_PYTHON_INSTALL_DIR:-$HOME/.local/share/uv/python}"/cpython-3.12*/bin/python3.12 \
        /usr/local/bin/python3.12 /usr/bin/python3.12 /usr/bin/python3; do
        if [ -n "$candidate" ] && base_of "$candidate"; then
            return
        fi
    done
    fail "Python 3.12 is missing: install it ('apt install python3.12-venv' on Ubuntu 24.04,\
 'uv python install 3.12' or 'pyenv install 3.12' elsewhere), or name one with PYTHON=PATH."
}

# Run the uv that the machine has, if it has one that runs.
uv_run() {
    for uv in uv "$HOME/.local/bin/uv" "$HOME/.cargo/bin/uv"; do
        if "$uv" --version >/dev/null 2>&1; then
            "$uv" "$@"
            return
        fi
    done
    return 127
}

make_venv() {
    rm -rf -- "$venv"
    if "$python" -c 'import ensurepip, venv' 2>/dev/null; then
        "$python" -m venv -- "$venv" || fail "$python cannot make a virtual environment."
    else
        uv_run venv --quiet --seed --no-project --python "$python" "$venv" || fail \
            "$python lacks its venv module: run 'apt install python3.12-venv', or install uv."
    fi
}

# uv installs the lock file in a tenth of pip's time, so it comes first, pinned by that very file.
# pip is what is left where uv does not reach the index: pip alone reads pip.conf.
install_lock() {
    if [ -z "${UV_DEFAULT_INDEX:-}" ] && [ -n "${PIP_INDEX_URL:-}" ]; then
        export UV_DEFAULT_INDEX="$PIP_INDEX_URL"
    fi
    sed -n '/^uv==/,/[^\\]$/p' requirements.lock >"$venv/uv.lock"
    "$venv/bin/python" -m pip install --quiet --no-deps --require-hashes \
        -r "$venv/uv.lock" >"$log" 2>&1 &&
        "$venv/bin/uv" pip install --quiet --no-deps --require-hashes --compile-bytecode \
            --python "$venv/bin/python" -r requirements.lock >>"$log" 2>&1 ||
        "$venv/bin/python" -m pip install --quiet --no-deps --require-hashes \
            -r requirements.lock >>"$log" 2>&1 ||
        explain
}

explain() {
    reason=$(grep -iE 'error|no space' "$log" | tail -n 1)
    if grep -qiE 'resolution|connect|timed? ?out|unreachable|network|versions: none' "$log"; then
        fail "the package index cannot be reached; connect to the network (or set PIP_INDEX_URL\
 to a mirror) and run it again. Last error: $reason"
    fi
    fail "the packages of requirements.lock cannot be installed: $reason (log: $log)"
}

[ "$(uname -s) $(uname -m)" = 'Linux x86_64' ] || fail \
    "this is $(uname -s) on $(uname -m), and the ROS 2 wheels exist for Linux on x86_64 only."

# One set-up at a time, whoever asks for it.
exec 9<"$0"
if command -v flock >/dev/null 2>&1; then
    flock 9
fi

if [ -x "$venv/bin/python" ]; then
    interpreter=$(readlink -f -- "$venv/bin/python")
else
    interpreter=none
fi
fingerprint() {
    printf '%s\n%s\n' "$venv" "$1"
    sha256sum requirements.lock
}
if [ "$(cat "$venv/lock.stamp" 2>/dev/null)" != "$(fingerprint "$interpreter")" ]; then
    python=$(find_python)
    log=$venv/setup.log
    echo "setup: making .venv with $python (once; about a minute)"
    make_venv
    install_lock
    fingerprint "$(readlink -f -- "$venv/bin/python")" >"$venv/lock.stamp"
fi

metadata=$(sha256sum setup.py setup.cfg package.xml pyproject.toml)
if [ "$(cat "$venv/package.stamp" 2>/dev/null)" != "$metadata" ]; then
    log=$venv/setup.log
    "$venv/bin/python" -m pip install --quiet --no-deps --no-build-isolation \
        --editable . >>"$log" 2>&1 || explain
    printf '%s\n' "$metadata" >"$venv/package.stamp"
fi

# What every first run would do, once: bytecode, which an environment may forbid to write, and the
# kernels. numba tells by the stamp of a source whether what it has kept still holds.
kernels=$(grep -rlE '^@(njit|kernel)' hapticvision_ros | sort | xargs -r stat -c '%n %s %y')
if [ "$(cat "$venv/kernels.stamp" 2>/dev/null)" != "$kernels" ]; then
    echo 'setup: compiling the kernels (once; about a minute)'
    log=$venv/setup.log
    "$venv/bin/python" -m compileall -q -j 0 "$venv/lib" hapticvision_ros >>"$log" 2>&1 || :
    # Without it, the first fit compiles what it needs.
    if "$venv/bin/python" tools/compile_kernels.py >>"$log" 2>&1; then
        printf '%s\n' "$kernels" >"$venv/kernels.stamp"
    else
        echo "setup: the kernels could not be compiled now; the first fit will (log: $log)" >&2
    fi
fi
