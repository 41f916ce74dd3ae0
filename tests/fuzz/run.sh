#!/usr/bin/env bash
# Runs the fuzzers side by side, at the lowest priority:  tests/fuzz/run.sh SECONDS [FOLDER]
# FUZZERS="case mesh" runs only those. Corpora, logs and what they find (crash-*, timeout-*, oom-*) are kept in FOLDER (build/fuzz/runs). Status 1 if there is anything.
set -uo pipefail
cd "$(dirname "$0")/../.."
seconds=${1:?usage: tests/fuzz/run.sh SECONDS [FOLDER]}
folder=$(realpath -m "${2:-build/fuzz/runs}")
fuzzers=${FUZZERS:-case mesh loads image}
mkdir -p "$folder"
/usr/bin/python3 tests/fuzz/seeds.py "$folder/seeds"
# A hang: FUZZ_TIMEOUT seconds (20) by the clock for one input, more on a busy machine. Memory: 1 GB, of which the sanitizer takes half.
for name in $fuzzers; do
  mkdir -p "$folder/$name"
  (cd "$folder/$name" && mkdir -p corpus && exec env TMPDIR=/dev/shm OMP_NUM_THREADS=1 UBSAN_OPTIONS=print_stacktrace=1 nice -n 19 \
    "$OLDPWD/build/fuzz/tests/fuzz/fuzz_$name" corpus "$folder/seeds/$name" -dict="$folder/seeds/$name.dict" \
    -max_total_time="$seconds" -timeout="${FUZZ_TIMEOUT:-20}" -rss_limit_mb=1024 -malloc_limit_mb=512 -max_len=8192 -print_final_stats=1 -artifact_prefix="$folder/$name/" >log 2>&1) &
done
wait
found=0
for name in $fuzzers; do
  echo "$name: $(sed -n 's/^stat::number_of_executed_units: *//p' "$folder/$name/log") executions, $(sed -n 's/^Done .* in \([0-9]*\) second.*/\1 s/p' "$folder/$name/log")"
  for file in "$folder/$name"/{crash,timeout,oom,leak}-*; do [ -e "$file" ] && { echo "  $file"; found=1; }; done
done
exit $found
