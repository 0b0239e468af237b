# What smoke tests share: displays, waiting for what the window shows, and an end that tells what failed and leaves nothing
# behind. Sourced, with $what for what failed and $work for the folder that goes.

# Waits up to $1 seconds until the rest of the arguments succeed.
wait_for() {
  local limit=$((SECONDS + $1))
  shift
  until "$@" >"$work/attempt.log" 2>&1; do
    if [ $SECONDS -ge $limit ]; then
      echo "waited in vain for: $*; the last attempt said:"
      cat "$work/attempt.log"
      return 1
    fi
    sleep 0.1
  done
}

servers=()
# Starts a display of its own, with the arguments besides; $display is its name.
new_display() {
  local reported="$work/display"
  rm -f "$reported"
  # Without -noreset the display goes away for a moment when the first program that asks it something ends.
  Xvfb -displayfd 3 -noreset -screen 0 1300x860x24 "$@" 3>"$reported" >>"$work/xvfb.log" 2>&1 &
  servers+=($!)
  wait_for 20 test -s "$reported"
  display=":$(cat "$reported")"
}

# Starts the display's window manager and waits until it manages: a window that comes while it starts may stay hidden for good.
start_manager() {
  rm -f "$work/managed"
  openbox --startup "touch $work/managed" >/dev/null 2>&1 &
  manager=$!
  wait_for 60 test -e "$work/managed"
}

# Finds the program's window anew: one that was found at first may go away again.
find_window() { window=$(xdotool search --pid "$app" --name "Lenslet Studio" | tail -n 1) && [ -n "$window" ]; }

# The mask's panel in a screenshot of the window.
mask=400x340+8+80

# The mask is drawn when its yellow peaks are.
drawn() {
  local colours
  find_window && import -window "$window" "$work/now.png" &&
    colours=$(convert "$work/now.png" -crop "$mask" -format '%k' info:) &&
    echo "window $window is $(xdotool getwindowgeometry "$window" | tr '\n' ' ') and has $colours colours" &&
    [ "$colours" -gt 8 ]
}

# What the program and the display were doing when something failed.
report() {
  echo "$what failed; the program said:"
  cat "$work/app.log" || true
  if kill -0 "${app:-}"; then
    echo "it goes on, with these threads:"
    for thread in /proc/"$app"/task/*; do
      echo "$(cat "$thread/comm"): $(sed 's/.*) //' "$thread/stat" | cut -d' ' -f1) in $(cat "$thread/wchan")"
    done
    echo "its windows: $(xdotool search --pid "$app" 2>&1 | tr '\n' ' ')"
  elif [ -n "${app:-}" ]; then
    local ended=0
    wait "$app" || ended=$?
    echo "it ended with code $ended"
  fi
  echo "display $display said:"
  cat "$work/xvfb.log" || true
} 2>/dev/null

finish() {
  code=$?
  [ $code -eq 0 ] || report
  kill "${app:-}" "${manager:-}" "${servers[@]}" 2>/dev/null || true
  rm -rf "$work"
}
trap finish EXIT
