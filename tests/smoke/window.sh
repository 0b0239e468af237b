#!/usr/bin/env bash
# The real window under a virtual display: drag a lenslet, see the PSF change, export, compare the files.
# usage: window.sh PROGRAM RENDERER [SCREENSHOT_FOLDER]
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
program=$(realpath "$1")
renderer=$2
shots=${3:-}
work=$(mktemp -d)
unset WAYLAND_DISPLAY
what="window smoke test ($renderer)"
. "$here/lib.sh"

new_display
export DISPLAY=$display
start_manager
cd "$work"
# A home of its own, so that it is the first window.
export XDG_DATA_HOME="$work/home"
"$program" --renderer "$renderer" >"$work/app.log" 2>&1 &
app=$!

screenshot() { import -window "$window" "$1"; }
# How many pixels differ between two screenshots, within $3.
pixels_between() {
  local differing
  differing=$(compare -metric AE "$work/$1.png[$3]" "$work/$2.png[$3]" null: 2>&1 || true)
  echo "${differing%%[. ]*}"
}
wait_for 120 drawn
focus() { xdotool windowactivate --sync "$window" || xdotool windowfocus "$window"; }
wait_for 20 focus
# Waits until the mask's panel is another than in screenshot $2 and rests, but for a caret; $1 is then its screenshot.
became_still() { wait_for 120 is_still "$@"; }
is_still() {
  screenshot "$work/earlier.png" && sleep 0.5 && screenshot "$work/$1.png" &&
    [ "$(pixels_between "$2" "$1" "$mask")" -gt 10000 ] && [ "$(pixels_between earlier "$1" "$mask")" -lt 200 ]
}

# The first window asks what to start from, over a mask that is dimmed; Escape leaves that open.
screenshot "$work/dimmed.png"
xdotool key --window "$window" Escape
became_still before dimmed

# The first lenslet stands at column 16, row 16 of the 32x32 mask, which lies in the panel at the upper left.
from_x=189 from_y=259
xdotool mousemove --window "$window" $from_x $from_y
sleep 0.3
xdotool mousedown 1
for step in 1 2 3 4 5 6 7 8; do
  xdotool mousemove --window "$window" $((from_x + 7 * step)) $((from_y - 5 * step))
  sleep 0.05
done
# The screenshot shows the lenslet under the pointer before that lets go, however slowly the window is drawn.
there="28x28+$((from_x + 42))+$((from_y - 54))"
arrived() {
  screenshot "$work/after.png"
  [ "$(pixels_between before after "$there")" -gt 200 ]
}
wait_for 120 arrived
xdotool mouseup 1
sleep 1

screenshot "$work/dragged.png"
xdotool key --window "$window" ctrl+e
became_still sheet dragged
xdotool key --window "$window" ctrl+a
xdotool type --delay 15 "$work/out"
xdotool key Return
wait_for 30 test -s "$work/out/lenslets.csv"

"$program" export --out "$work/default" >/dev/null
"$program" export "$work/out/design.json" --out "$work/again" >/dev/null
cmp "$work/out/psf.npy" "$work/again/psf.npy"
cmp "$work/out/design.json" "$work/again/design.json"
if cmp -s "$work/out/psf.npy" "$work/default/psf.npy"; then
  echo "the drag did not change the exported PSF"
  exit 1
fi
[ "$(wc -l <"$work/out/lenslets.csv")" -eq 10 ]
grep -q '^9.0,7.0,0.8,' "$work/out/lenslets.csv" || { echo "the second lenslet should not have moved"; exit 1; }

became_still end sheet
if [ -n "$shots" ]; then
  mkdir -p "$shots"
  cp "$work/end.png" "$shots/window-$renderer.png"
fi
# Closing asks about the unsaved change instead of losing it.
xdotool key --window "$window" ctrl+q
became_still question end
kill -0 "$app" 2>/dev/null || { echo "the window closed over unsaved changes"; exit 1; }
echo "window smoke test ($renderer): dragged, exported, compared"
