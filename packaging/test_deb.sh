#!/usr/bin/env bash
# The Debian package: built around a program (or given), unpacked into an empty folder, and used from there.
# usage: test_deb.sh PROGRAM_OR_DEB
set -euo pipefail
given=$(realpath "$1")
cd "$(dirname "$0")/.."
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

if ! command -v dpkg-deb >/dev/null; then
  echo "skipped: dpkg-deb is missing, so no Debian package can be unpacked"
  exit 0
fi

package=$given
if [[ $given != *.deb ]]; then
  if ! command -v cargo-deb >/dev/null; then
    echo "skipped: cargo-deb is missing; install it by 'cargo install cargo-deb --locked'"
    exit 0
  fi
  # cargo-deb packs what lies at target/release: the given program, whatever its profile.
  mkdir -p "$work/target/release"
  cp "$given" "$work/target/release/lenslet-studio"
  package=$work/lenslet-studio.deb
  CARGO_TARGET_DIR=$work/target cargo deb --no-build --fast --locked --output "$package"
fi

dpkg-deb --info "$package"
dpkg-deb -x "$package" "$work/root"
share=$work/root/usr/share

files=(
  applications/lenslet-studio.desktop
  mime/packages/lenslet-studio.xml
  icons/hicolor/scalable/apps/lenslet-studio.svg
  icons/hicolor/{48x48,128x128,256x256}/apps/lenslet-studio.png
  bash-completion/completions/lenslet-studio
  fish/vendor_completions.d/lenslet-studio.fish
  zsh/vendor-completions/_lenslet-studio
  doc/lenslet-studio/{copyright,README.md,CHANGELOG.md,CITATION.cff,LICENSE-MIT,LICENSE-APACHE}
  doc/lenslet-studio/docs/start/install.md
  doc/lenslet-studio/assets/studio.png
)
for file in "${files[@]}"; do
  # Texts may be compressed.
  [ -s "$share/$file" ] || [ -s "$share/$file.gz" ] || { echo "the package lacks /usr/share/$file" >&2; exit 1; }
done

# The desktop file starts the program, shows the icon, and opens what the MIME type names.
desktop=$share/applications/lenslet-studio.desktop
mime=$share/mime/packages/lenslet-studio.xml
for line in "Exec=lenslet-studio %f" "Icon=lenslet-studio" "StartupWMClass=lenslet-studio"; do
  grep -qx "$line" "$desktop" || { echo "the desktop file lacks the line $line" >&2; exit 1; }
done
type=$(sed -n 's/^MimeType=\(.*\);$/\1/p' "$desktop")
grep -qF "mime-type type=\"$type\"" "$mime" || { echo "the MIME file does not define $type" >&2; exit 1; }
if command -v desktop-file-validate >/dev/null; then
  desktop-file-validate "$desktop"
else
  echo "skipped: desktop-file-validate is missing"
fi
if command -v xmllint >/dev/null; then
  xmllint --noout "$mime" "$share/icons/hicolor/scalable/apps/lenslet-studio.svg"
else
  echo "skipped: xmllint is missing"
fi

# The program, from an empty folder and without a display.
unset DISPLAY WAYLAND_DISPLAY
export PATH=$work/root/usr/bin:$PATH
mkdir "$work/empty"
cd "$work/empty"
lenslet-studio --version
lenslet-studio bounds --mask heuristic:4 --objects beads:0.02 --json >bounds.json
grep -q '"gaussian_bound"' bounds.json || { echo "bounds gave no Gaussian bound:" >&2; cat bounds.json >&2; exit 1; }

# Designs that the program writes are of the MIME type by their content too.
lenslet-studio export --mask heuristic:4 --out exported >/dev/null
head -c 60 exported/design.json | grep -qF '"format": "lenslet-studio/design"'
if command -v update-mime-database >/dev/null && command -v gio >/dev/null; then
  export XDG_DATA_HOME=$share
  update-mime-database "$share/mime"
  cp exported/design.json four.lenslet.json
  cp exported/design.json four
  for design in four.lenslet.json four; do
    gio info -a standard::content-type "$design" | grep -F "$type"
  done
else
  echo "skipped: update-mime-database or gio is missing"
fi

complete=$(bash -c '. "$1" && complete -p lenslet-studio' - "$share/bash-completion/completions/lenslet-studio")
[ -n "$complete" ] || { echo "bash gets no completions" >&2; exit 1; }
echo "The Debian package holds."
