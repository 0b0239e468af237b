# What smoke tests share: waiting, and an end that leaves nothing behind. Sourced, with $what for what failed and $work for
# the folder that goes.

# Waits up to $1 seconds until the rest of the arguments succeed.
wait_for() {
  local limit=$((SECONDS + $1))
  shift
  until "$@" >/dev/null 2>&1; do
    [ $SECONDS -lt $limit ] || { echo "waited in vain for: $*"; return 1; }
    sleep 0.1
  done
}

# Starts a display of its own, with the arguments besides; $display is its name, $server its process.
new_display() {
  local told="$work/display"
  rm -f "$told"
  # Without -noreset the display goes away for a moment when the first program that asks it something ends.
  Xvfb -displayfd 3 -noreset -screen 0 1300x860x24 "$@" 3>"$told" >"$work/xvfb.log" 2>&1 &
  server=$!
  wait_for 20 test -s "$told"
  display=":$(cat "$told")"
}

finish() {
  code=$?
  kill "${app:-}" "${manager:-}" "${xvfb:-}" "${xvfb_dark:-}" "${server:-}" 2>/dev/null || true
  if [ $code -ne 0 ]; then
    echo "$what failed; the program said:"
    cat "$work/app.log" 2>/dev/null || true
  fi
  rm -rf "$work"
}
trap finish EXIT
