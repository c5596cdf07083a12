#!/bin/sh
# Makes src/kreisel/viewer/assets/library.min.js and library.css again, in a scratch folder; needs Node.js and npm.
set -eu
assets=$(cd "$(dirname "$0")/../../src/kreisel/viewer/assets" && pwd)
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
cd "$scratch"
npm init --yes >/dev/null
npm install --silent --no-audit --no-fund three@0.187.0 uplot@1.6.32 esbuild@0.28.2
cp "$assets/library.mjs" .
npx esbuild library.mjs --bundle --minify --format=iife --global-name=Library --target=es2022 --legal-comments=none \
  --charset=utf8 --log-level=error --outfile="$assets/library.min.js"
cp node_modules/uplot/dist/uPlot.min.css "$assets/library.css"
cd "$assets" && sha256sum library.min.js library.css
