#!/usr/bin/env bash
# Writes requirements/*.txt anew: every package of every platform with its version and its hashes, and no host.
#
#     tests/lock.sh             after a change of the dependencies in pyproject.toml; the other versions stay
#     tests/lock.sh --upgrade   all to the newest versions
set -euo pipefail
cd "$(dirname "$0")/.."
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/env"
"$work/env/bin/python" -m pip install --quiet --disable-pip-version-check uv
printf "hatchling\neditables\n" >"$work/build.in" # which install the project itself

lock() { # NAME, options
  "$work/env/bin/python" -m uv pip compile --quiet --universal --python-version 3.11 --generate-hashes \
    --no-emit-index-url --no-emit-find-links --no-header --no-annotate \
    "${@:2}" pyproject.toml "$work/build.in" -o "requirements/$1.txt"
}
lock dev --extra dev "$@"
lock run -c requirements/dev.txt "$@"
lock oracles --extra oracles -c requirements/dev.txt "$@"
! grep -n "://" requirements/*.txt
