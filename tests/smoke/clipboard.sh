#!/usr/bin/env bash
# The clipboard of the real window is that of the system: another program reads what the window copies, and the window
# pastes what another program copied.
# usage: clipboard.sh PROGRAM
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
program=$(realpath "$1")
work=$(mktemp -d)
unset WAYLAND_DISPLAY
what="clipboard smoke test"
. "$here/lib.sh"

new_display
export DISPLAY=$display
start_manager
cd "$work"
export XDG_DATA_HOME="$work/home"
"$program" export --out "$work/other" >/dev/null
# A design whose name the window has not seen, for the way in.
cp "$work/other/design.json" "$work/pasted, 0,46.json"
"$program" "$work/other/design.json" >"$work/app.log" 2>&1 &
app=$!

wait_for 120 drawn
focus() { xdotool windowactivate --sync "$window" || xdotool windowfocus "$window"; }
wait_for 20 focus
held() { xclip -o -selection clipboard >"$work/held" && grep -q "$1" "$work/held"; }
titled() { [[ "$(xdotool getwindowname "$window")" == "$1"* ]]; }

copy_command_line() {
  xdotool key --window "$window" ctrl+k
  sleep 1
  xdotool type --delay 15 "Copy command line"
  sleep 1
  xdotool key Return
  wait_for 30 held '^lenslet-studio '
}

# Out, by a button: the command line, which another program runs.
copy_command_line
copied=$(cat "$work/held")

# In: a path that another program copied is opened.
printf '%s' "$work/pasted, 0,46.json" | xclip -selection clipboard -i
xdotool key --window "$window" ctrl+o
sleep 1
xdotool key ctrl+a ctrl+v
sleep 1
# Out, by the keys of a text field.
xdotool key ctrl+a ctrl+x
wait_for 30 held '/pasted, 0,46.json$'
xdotool key ctrl+v
sleep 1
xdotool key Return
wait_for 30 titled "pasted, 0,46.json"

# A text that the window holds ends with it on a display without a clipboard manager; the window does not wait for one.
copy_command_line
xdotool key --window "$window" ctrl+q
gone() { ! kill -0 "$app" 2>/dev/null; }
wait_for 30 gone
echo "clipboard smoke test: copied ${#copied} characters to xclip, pasted from it"
