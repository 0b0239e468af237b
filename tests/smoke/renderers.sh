#!/usr/bin/env bash
# A renderer that cannot start leads to the other one and a notice; where neither can, the program says so in one sentence
# and computes the design instead.
# usage: renderers.sh PROGRAM
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
program=$(realpath "$1")
work=$(mktemp -d)
unset WAYLAND_DISPLAY
export XDG_DATA_HOME="$work/home"
cd "$work"

no_egl=__EGL_VENDOR_LIBRARY_FILENAMES=/nonexistent
# An interface that this system does not have.
no_wgpu=WGPU_BACKEND=metal
what="smoke test of the renderers"
. "$here/lib.sh"

new_display
usual=$display
# Neither GLX nor, for lack of a driver, EGL: no OpenGL.
new_display -extension GLX
dark=$display

# Not the first window, in a theme whose notices are of a known colour.
mkdir -p "$work/home/lenslet-studio"
echo '{"welcomed": true, "theme": "Dark", "live": false}' >"$work/home/lenslet-studio/preferences.json"
# Pixels of notices in the status bar, at the lower edge.
notices() {
  find_window && import -window "$window" "$work/now.png" &&
    convert "$work/now.png" -crop 900x24+0+776 -fill black +opaque '#ff8f00' -fill white -opaque '#ff8f00' \
      -format '%[fx:int(w*h*mean+0.5)]' info:
}
noticed() { [ "$(notices)" -gt 50 ]; }

# Opens the window by renderer $1 on a display where that cannot start, as the rest of the arguments see to.
the_other_draws() {
  local renderer=$1
  shift
  env "$@" "$program" --renderer "$renderer" >"$work/app.log" 2>&1 &
  app=$!
  wait_for 120 noticed
  wait_for 120 drawn
  kill -0 "$app"
  kill "$app"
  wait "$app" 2>/dev/null || true
}

export DISPLAY=$dark
the_other_draws glow "$no_egl"

env "$no_egl" "$no_wgpu" timeout 60 "$program" --renderer wgpu >"$work/out.log" 2>"$work/app.log"
grep -q '^no window could be opened (wgpu: .*; OpenGL (glow): .*); .*; the design is computed here instead\.$' "$work/app.log"
grep -q 'Gaussian bound' "$work/out.log"
test -s "$work/lenslet-studio-export/design.json"

export DISPLAY=$usual
the_other_draws wgpu "$no_wgpu"
echo "smoke test of the renderers: each stands in for the other, and the command line for both"
