#!/usr/bin/env bash
# The client from fresh environments: the newest release of each dependency on the newest Python at hand, and the
# lower bounds of its pyproject.toml on the oldest.
set -euo pipefail
cd "$(dirname "$0")/../.."
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT

at_hand() { # the first of these that starts
  for python in "$@"; do
    if "$python" -c '' 2>/dev/null; then echo "$python" && return; fi
  done
}
lowest=$(python3 -c 'import tomllib
for one in tomllib.load(open("clients/python/pyproject.toml", "rb"))["project"]["dependencies"]:
    print(one.split(",")[0].replace(">=", "=="))')

# A copy, for building leaves files in the sources.
cp -r clients/python "$folder/client" && rm -rf "$folder/client/build"
check() { # a name, an interpreter, further requirements
  "$2" -m venv "$folder/$1"
  "$folder/$1/bin/pip" install --quiet --no-compile --disable-pip-version-check "$folder/client" "${@:3}"
  "$folder/$1/bin/python" -W error tests/clients/alone.py
}
check newest "$(at_hand python3.13 ~/.pyenv/versions/3.13.*/bin/python python3.12 python3.11 python3)" &
newest=$!
# shellcheck disable=SC2086
check lowest "$(at_hand python3.11 python3.12 python3)" $lowest
wait "$newest"
