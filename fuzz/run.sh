#!/usr/bin/env bash
# Fuzzes every decoder with so many executions each (default 100 000 000), or only the targets named after that.
# What it finds that is new stays in target/fuzz/corpus; fuzz/corpus holds the golden frames it begins with.
set -euo pipefail
cd "$(dirname "$0")"
runs="${1:-100000000}"
shift || true
out="${CARGO_TARGET_DIR:-../target}/fuzz"
# libFuzzer's counters by two of LLVM's stable options: no nightly compiler, no cargo-fuzz.
export RUSTFLAGS="-Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 -Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table"
host="$(rustc -vV | sed -n 's/^host: //p')"
CARGO_TARGET_DIR="$out" cargo build --release --locked --quiet --target "$host"
for source in targets/*.rs; do
    name="$(basename "$source" .rs)"
    if [ $# -gt 0 ] && [[ " $* " != *" $name "* ]]; then continue; fi
    mkdir -p "$out/corpus/$name" "$out/crashes"
    # Frames are short, report descriptors are not.
    longest=80
    if [ "$name" = hid ]; then longest=256; fi
    "$out/$host/release/$name" -runs="$runs" -max_len="$longest" -artifact_prefix="$out/crashes/$name-" -verbosity=0 -print_final_stats=1 \
        "$out/corpus/$name" "corpus/$name" 2>&1 | awk -v name="$name" '
            /number_of_executed_units/ { runs = $2 } /average_exec_per_sec/ { rate = $2 }
            /panicked|ERROR|assertion/ { print } END { if (runs) print name ": " runs " executions, " rate "/s" ; else exit 1 }'
done
