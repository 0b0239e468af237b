#!/usr/bin/env bash
# The Python package: its wheel, built by the development profile, in a new environment.
# usage: test_wheel.sh
set -euo pipefail
cd "$(dirname "$0")/.."
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

if ! python3 -m venv "$work/build" >"$work/log" 2>&1; then
  echo "skipped: Python 3 with venv and pip is missing"
  exit 0
fi
if ! "$work/build/bin/pip" install --quiet --retries 1 --timeout 30 'maturin>=1.9,<2' >"$work/log" 2>&1; then
  echo "skipped: maturin cannot be installed: $(tail -n 1 "$work/log")"
  exit 0
fi

# Tests choose other features of some crates than a build of the program alone. Where an example is built too, cargo takes
# those of the tests and compiles nothing again. maturin must not hear of the example: it would pack it.
real_cargo=$(command -v cargo)
cat >"$work/cargo" <<END
#!/usr/bin/env bash
set -o pipefail
[ "\$1" = rustc ] || exec "$real_cargo" "\$@"
"$real_cargo" "\$@" --example psf_and_measurement | grep -v '"name":"psf_and_measurement"'
END
chmod +x "$work/cargo"
CARGO=$work/cargo "$work/build/bin/maturin" build --profile dev --compatibility linux --compression-method stored --out "$work/wheels"

python3 -m venv "$work/user"
"$work/user/bin/pip" install --quiet --no-index --no-deps "$work"/wheels/*.whl

unset DISPLAY WAYLAND_DISPLAY
export PATH=$work/user/bin:$PATH
mkdir "$work/empty"
cd "$work/empty"
[ "$(command -v lenslet-studio)" = "$work/user/bin/lenslet-studio" ]
lenslet-studio --version
lenslet-studio bounds --mask heuristic:4 --objects beads:0.02 --json |
  python3 -c 'import json, sys; print(json.load(sys.stdin)["information"]["gaussian_bound"], "bits per pixel")'
echo "The Python package holds."
