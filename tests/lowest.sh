#!/usr/bin/env bash
# The fast tests with the oldest versions of the dependencies that pyproject.toml allows, in an environment of their own.
#
#     tests/lowest.sh [lowest|newest] [arguments of pytest]
#
# Prints the versions and the date; CONTRIBUTING.md records the results. Test tools are the newest in either case.
set -euo pipefail
cd "$(dirname "$0")/.."
which=${1:-lowest}
shift || true
case $which in
  lowest) resolution=lowest-direct warnings=(-W ignore::DeprecationWarning) ;; # of the old about what is newer than they
  newest) resolution=highest warnings=() ;;
  *) echo "tests/lowest.sh: '$which' is neither lowest nor newest" >&2; exit 2 ;;
esac

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/env"
python=$work/env/bin/python
"$python" -m pip install --quiet --disable-pip-version-check uv
"$python" -m uv pip compile --quiet --python "$python" --resolution $resolution --no-header --no-annotate \
  pyproject.toml -o "$work/versions.txt"
"$python" -m uv pip install --quiet --python "$python" -r "$work/versions.txt" -e ".[dev]"

date -u +"%F, $("$python" --version), $which:"
grep -f <(sed -n '/^dependencies/,/^]/s/^ *"\([A-Za-z-]*\).*/^\1==/p' pyproject.toml) "$work/versions.txt" | paste -sd ' '
# not PYTHONPATH of the caller: it may name another copy
env -u PYTHONPATH "$python" -m pytest -q -m "not slow" -p no:cacheprovider "${warnings[@]}" "$@"
