#!/bin/bash
# Run the tests of a fresh clone of HEAD repeatedly, every second time with four busy loops: bench/trust.sh [RUNS]
set -eu
clone=$(mktemp -d) runs=${1:-20} passed=0
trap 'kill -- ${loops:+-$loops} 2>/dev/null || true; rm -rf "$clone"' EXIT
git clone --quiet . "$clone/diffbot"
cd "$clone/diffbot"
unset MAKEFLAGS MAKELEVEL MFLAGS
make setup
for run in $(seq "$runs"); do
    if ((run % 2 == 0)); then setsid bash -c 'for _ in 1 2 3 4; do while :; do :; done & done; wait' & loops=$!; fi
    if make test >../log 2>&1; then passed=$((passed + 1)); else cat ../log; fi
    echo "run $run: $(tail -n 1 ../log)"
    kill -- ${loops:+-$loops} 2>/dev/null || true
    loops=
done
echo "$passed of $runs passed"
((passed == runs))
