#!/usr/bin/env bash
# Random clicks, drags, turns of the wheel and keys on the real window under a virtual display, beside a run: the program
# does not panic, and its memory is printed. A window that chance has closed is opened again.
# usage: soak.sh PROGRAM MINUTES [RENDERER]
set -euo pipefail
program=$(realpath "$1")
minutes=$2
renderer=${3:-glow}
work=$(mktemp -d)
unset WAYLAND_DISPLAY
what="soak test"
. "$(dirname "$(realpath "$0")")/lib.sh"
new_display
export DISPLAY=$display
# Nothing that chance types as a path leaves this folder.
export XDG_DATA_HOME="$work/home"
cd "$work"

start_manager

# Opens the window and starts a run in it.
open_window() {
  "$program" --renderer "$renderer" >>"$work/app.log" 2>&1 &
  app=$!
  window=
  while [ -z "$window" ]; do
    sleep 0.2
    kill -0 "$app"
    find_window || true
  done
  sleep 4
  xdotool windowactivate --sync "$window" 2>/dev/null || true
  xdotool key Escape
  sleep 1
  xdotool key ctrl+k
  sleep 1
  xdotool type --delay 15 "start a run"
  sleep 1
  xdotool key Return
}

keys=(Tab Escape Delete Left Down space F1 plus minus 0 ctrl+z ctrl+z ctrl+shift+z ctrl+a ctrl+d ctrl+m Return 1 2 5 period)
# The same deeds every time.
RANDOM=7
open_window
opened=1 deeds=0 reported=0 end=$((SECONDS + 60 * minutes))
while [ $SECONDS -lt $end ]; do
  x=$((5 + RANDOM % 1260)) y=$((30 + RANDOM % 740))
  case $((RANDOM % 6)) in
    0) xdotool key "${keys[RANDOM % ${#keys[@]}]}" ;;
    1) xdotool mousemove --window "$window" $x $y click $((4 + RANDOM % 2)) ;;
    2) xdotool mousemove --window "$window" $((10 + RANDOM % 400)) $((80 + RANDOM % 340)) mousedown 1 \
      mousemove_relative -- $((RANDOM % 80 - 40)) $((RANDOM % 80 - 40)) mouseup 1 ;;
    *) xdotool mousemove --window "$window" $x $y click 1 ;;
  esac 2>/dev/null || true
  deeds=$((deeds + 1))
  if ! kill -0 "$app" 2>/dev/null; then
    wait "$app" || { echo "the program ended by itself:"; tail -n 20 "$work/app.log"; exit 1; }
    opened=$((opened + 1))
    open_window
  fi
  if [ $((SECONDS / 20)) -ne $reported ]; then
    reported=$((SECONDS / 20))
    awk '/VmRSS/ {printf "%d MB ", $2 / 1000}' "/proc/$app/status"
  fi
done
echo
if grep -q panicked "$work/app.log"; then
  cat "$work/app.log"
  exit 1
fi
echo "soak ($renderer): $deeds deeds in $minutes min, the window was opened $opened times, no panic"
