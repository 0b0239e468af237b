#!/usr/bin/env bash
# Pictures of the three jobs for the README: editing a mask, a run, an export; and designs side by side.
# usage: screenshots.sh PROGRAM FOLDER
set -euo pipefail
program=$(realpath "$1")
mkdir -p "$2"
shots=$(realpath "$2")
work=$(mktemp -d)
unset WAYLAND_DISPLAY
what=screenshots
. "$(dirname "$0")/lib.sh"
new_display
export DISPLAY=$display XDG_DATA_HOME="$work/home"
start_manager
# Not the first window: that one asks what to start from.
mkdir -p "$work/home/lenslet-studio"
echo '{"welcomed": true}' >"$work/home/lenslet-studio/preferences.json"
"$program" >"$work/app.log" 2>&1 &
app=$!
sleep 6
window=$(xdotool search --pid "$app" --name "Lenslet Studio" | tail -n 1)
xdotool windowactivate --sync "$window"

# Does an action by its name.
do_action() {
  xdotool key ctrl+k
  sleep 1
  xdotool type --delay 20 "$1"
  sleep 0.5
  xdotool key Return
  sleep 1
}
shoot() { import -window "$window" "$shots/$1.png"; }

sleep 20
shoot studio
xdotool key ctrl+e
sleep 1
shoot export
xdotool key Escape
sleep 1
for mask in "9 lenslets, heur" "4 lenslets, heur" "mask: 25 random"; do
  do_action "$mask"
  sleep 8
  xdotool key ctrl+d
done
sleep 2
shoot compare
do_action "start a run"
sleep "${RUN_SECONDS:-240}"
shoot run
