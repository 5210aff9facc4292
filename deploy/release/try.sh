#!/usr/bin/env bash
# Install a wheel or a source distribution into an empty environment, and play the first run there, in an empty folder:
# try.sh FILE REQUIREMENTS. Its digest must be the one that the package carries.
set -euo pipefail
file=$(realpath "$1") requirements=$(realpath "$2")
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
echo "$(basename "$file"): into an empty environment"
"${PYTHON:-python3}" -m venv "$folder/env"
pip=("$folder/env/bin/python" -m pip --quiet --quiet --disable-pip-version-check)
"${pip[@]}" install --no-deps --require-hashes -r "$requirements"
case $file in *.tar.gz) "${pip[@]}" install --no-deps --no-build-isolation "$file" ;; *) "${pip[@]}" install --no-deps "$file" ;; esac
cd "$folder"
unset PYTHONPATH
COGRADAR_CACHE_DIR=$folder/kernels env/bin/cogradar run paper --in-process --seed 1 >run.txt
tail -n 12 run.txt
digest=$(env/bin/python -c 'from cogradar.services.bench import golden; import json
print(json.loads(golden.FILE.read_text())["README"]["1"])')
grep -q "$digest" run.txt || { echo "$(basename "$file"): the digest is not $digest" >&2; exit 1; }
echo "$(basename "$file"): installed, and the first run has the digest of every other machine"
