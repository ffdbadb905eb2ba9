#!/usr/bin/env bash
# Prints the tables of BENCHMARKS.md.
#
#   scripts/benchmarks.sh quick [PART...]      small settings of every part (or of these): does everything still work?
#   scripts/benchmarks.sh [full] [PART...]     the settings of BENCHMARKS.md; all parts take some hours on two cores
#   scripts/benchmarks.sh readme               the table of README.md, and its picture as docs/preview.png
#   scripts/benchmarks.sh first                how long the first commands of README.md take
#   scripts/benchmarks.sh help                 this text and the parts
#
# Finished parts and runs are found again in target/benchmarks/MODE-PROGRAM (RESULTS: another folder), so what was interrupted
# goes on; PROGRAM are the first digits of the program's checksum, so that results of two programs never mix. A part that fails
# is named at the end, with exit code 1; the others are printed all the same. A full run of a source without changes puts
# its tables into benchmarks/results.json, from which scripts/results.py prints README.md and BENCHMARKS.md.
#
# MONOGRID_DATA: the folder of the recordings (scripts/data.sh). BIN: another program than that of this source, with
# COMMIT, the commit that it was built from.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/common.sh
parts=(sequences accuracy small thesis solver demo depth worlds paths sweep engine queries octomap live speed room loops
  kidnap fragments sessions odometry survey size)

mode=full
case ${1:-full} in
  quick | full) mode=${1:-full}; shift || true ;;
  help | -h | --help) sed -n '2,/^set -/{s/^# \{0,1\}//p}' "$0"; echo "parts: ${parts[*]}"; exit 0 ;;
esac
wanted=("$@")
[ ${#wanted[@]} -gt 0 ] || wanted=("${parts[@]}")

if [ -z "${BIN:-}" ]; then
  # the commit of what is built, where it is known
  [ -n "$(git status --porcelain)" ] || export COMMIT=${COMMIT:-$(git rev-parse HEAD)}
  cargo build --quiet --release -p monogrid-cli
  export BIN=${CARGO_TARGET_DIR:-target}/release/monogrid
fi
bin=$BIN
export RESULTS=${RESULTS:-target/benchmarks/$mode-$(sha256sum <"$bin" | cut -c1-12)}
results=$RESULTS
mkdir -p "$results"

if [ "$mode" = quick ]; then
  sequences=(tsukuba icl-office kitti-forward euroc-static)
  export RUNS=1 MAX_FRAMES=60
  worlds=(office) world_frames=300 truth=0.032 cells=(0.064) demo_frames=300 corridor_frames=300 corridor_options=(--quick-light) starts=1 cases=2 room_frames=600
  accuracy=(tsukuba kitti-forward) depth_sequences=(icl-office) thesis=(tsukuba) speed_runs=1 speed_sequence=tsukuba survey_size=160x120 survey_sequences=(office:hand:demo)
  export CELLS=0.064 THREAD_CELLS=0.064 QUALITY_CELLS=0.128 MEMORY_CELLS=0.064
  scans=8
else
  sequences=(red-kitchen tsukuba icl-office icl-office-kt3 kitti-forward kitti-07 fr1-desk euroc-static)
  export RUNS=${RUNS:-5}
  worlds=(office living-room machine-hall) world_frames=1500 truth=0.008 cells=(0.008 0.016 0.032 0.064 0.128)
  corridor_frames=2000 corridor_options=() starts=10 cases=20 room_frames=18000
  depth_sequences=(red-kitchen fr1-desk icl-office-kt3)
  accuracy=(red-kitchen tsukuba icl-office icl-office-kt3 kitti-forward kitti-07 fr1-desk)
  thesis=(icl-office tsukuba red-kitchen kitti-forward) speed_runs=5 speed_sequence=red-kitchen survey_size=640x480 survey_sequences=()
  export MACHINE=1
  scans=45
fi

# example -p CRATE --example NAME ARGUMENT...: an example of a crate, its output as it comes, as a block of code.
example() {
  echo
  echo "    \$ $4 ${*:5}"
  cargo run --quiet --release "${@:1:4}" -- "${@:5}" | sed 's/^/    /'
}
# The output of another script as a block of code.
verbatim() {
  echo
  echo "    \$ $*"
  "$@" | sed 's/^/    /'
}
# A run of a sequence with the default settings, once.
plain_run() { kept_run "$results/$1-plain" run "$data/$1"; }
# A rendered world, once: WORLD FRAMES OPTION...
world() { kept_run "$results/world-$1-$2" synth "$1" --frames "$2" "${@:3}"; }
room() {
  local finest=$truth
  if [ "$1" = machine-hall ]; then finest=0.032; fi
  world "$1" "$world_frames" --depth-every 5 --truth-resolution "$finest"
  source=$results/world-$1-$world_frames
}
# The run of a world from a metric seed depth, in the frame of the truth: $run, and its world $source.
room_run() {
  room "$1"
  run=$results/run-$1
  kept_run "$run" run "$source" --seed-depth dataset --align "gt:$source/groundtruth.txt"
}
# The map of a world with cells of a size: $map.
room_map() {
  room_run "$1"
  map=$run-$2.ot
  [ -f "$map.json" ] || rm -f "$map"
  kept "$map.json" "$bin" map "$run/recording.mgk" --align "gt:$source/groundtruth.txt" --profile default --resolution "$2" \
    --out "$map" --json
}

# One line of the table of sequences.
sequence_row() {
  plain_run "$1"
  local run=$results/$1-plain code
  code=$(cat "$run.exit")
  if evaluated "$run" "$data/$1"; then
    echo "| $1 | $(value "$run.json" frames) | $(digits 3 "$(value "$run.ate" path_length)") m | $(digits 2 "$(value "$run.ate" ate_rmse)") m" \
      "| $(digits 3 "$(value "$run.ate" scale_drift)") | $(value "$run.json" tracked) | $(value "$run.json" lost_episodes)" \
      "| $(value "$run.json" keyframes) |"
  else
    echo "| $1 | $(value "$run.json" frames) | | no pose, exit code $code | | $(value "$run.json" tracked) | | $(value "$run.json" keyframes) |"
  fi
}

part_sequences() {
  echo '| sequence | frames | path with a pose | ATE | scale drift | frames with a pose | lost | keyframes |'
  echo '|---|---|---|---|---|---|---|---|'
  for sequence in "${sequences[@]}"; do sequence_row "$sequence"; done
}

part_accuracy() { scripts/accuracy.sh default "${accuracy[@]}"; }

# A small computer: poses, and speed with two cores and with one.
part_small() {
  scripts/accuracy.sh fast "${accuracy[@]}"
  echo
  speed_table fast
}

part_thesis() { scripts/accuracy.sh thesis "${thesis[@]}"; }

part_solver() {
  plain_run tsukuba
  cargo build --quiet --release -p monogrid-graph --example optimise_g2o
  verbatim python3 crates/monogrid-graph/tests/g2o/verify.py "${CARGO_TARGET_DIR:-target}/release/examples/optimise_g2o" \
    "$results/tsukuba-plain/graph.g2o"
}

demo_run() { kept_run "$results/demo" demo ${demo_frames:+--max-frames "$demo_frames"}; }

part_demo() {
  demo_run
  local run=$results/demo.json
  echo '| | demo |'
  echo '|---|---|'
  echo "| frames, with a pose | $(value "$run" frames), $(value "$run" tracked) |"
  echo "| ATE, scale drift | $(digits 2 "$(value "$run" trajectory ate_rmse)") m, $(digits 3 "$(value "$run" trajectory scale_drift)") |"
  echo "| depth within 3 % of pixels with a gradient | $(digits 2 "$(value "$run" depth within_3_percent)") |"
  echo "| normalised error: median, robust deviation, within two sigma | $(digits 2 "$(value "$run" depth normalised_error median)")," \
    "$(digits 2 "$(value "$run" depth normalised_error robust_deviation)"), $(digits 3 "$(value "$run" depth normalised_error within_2_sigma)") |"
  echo "| map, observed cells: AUC, MCC | $(digits 3 "$(value "$run" map_error observed auc)"), $(digits 3 "$(value "$run" map_error observed mcc)") |"
  echo "| memory | $(value "$run" peak_rss_bytes | awk '{ printf "%.2g GB", $1 / 1e9 }') |"
}

depth_row() {
  local report=$2.depth${4:-}.json
  kept "$report" "$bin" evaluate depth "$2/recording.mgk" "$3" "${@:4}" --json
  echo "| $1${4:+, refined} | $(value "$report" keyframes) | $(digits 3 "$(value "$report" estimates_within_3_percent)") | $(digits 3 "$(value "$report" estimates_within_10_percent)")" \
    "| $(digits 2 "$(value "$report" normalised_error median)") | $(digits 2 "$(value "$report" normalised_error robust_deviation)")" \
    "| $(digits 3 "$(value "$report" normalised_error within_2_sigma)") |"
}

part_depth() {
  echo '| depths of | keyframes with a depth image | within 3 % | within 10 % | normalised error: median | robust deviation | within two sigma |'
  echo '|---|---|---|---|---|---|---|'
  for name in "${worlds[@]}"; do
    room_run "$name"
    for refined in '' --refined; do depth_row "$name" "$run" "$source" ${refined:+"$refined"}; done
  done
  for name in "${depth_sequences[@]}"; do
    plain_run "$name"
    for refined in '' --refined; do depth_row "$name" "$results/$name-plain" "$data/$name" ${refined:+"$refined"}; done
  done
}

map_row() {
  room_map "$1" "$2"
  local report=$map.error
  kept "$report" "$bin" evaluate map "$map" "$source/truth.ot" --recording "$run/recording.mgk" \
    --align "gt:$source/groundtruth.txt" --json
  echo "| $1 | $2 m | $(digits 3 "$(value "$report" observed auc)") | $(digits 3 "$(value "$report" known auc)")" \
    "| $(digits 3 "$(value "$report" observed mcc)") | $(digits 2 "$(value "$report" observed precision)")" \
    "| $(digits 2 "$(value "$report" observed recall)") | $(digits 2 "$(value "$report" coverage_free_in_view)")," \
    "$(digits 2 "$(value "$report" coverage_occupied_in_view)") | $(digits 2 "$(value "$run.json" ate_rmse)") m" \
    "| $(digits 2 "$(value "$map.json" seconds)") s, $(value "$map.json" peak_rss_bytes | awk '{ printf "%.2f GB", $1 / 1e9 }') |"
}

part_worlds() {
  echo '| world | cell | AUC observed | AUC known | MCC | precision | recall | true free, occupied cells in view observed | ATE | CPU of integration, memory |'
  echo '|---|---|---|---|---|---|---|---|---|---|'
  for name in "${worlds[@]}"; do
    for cell in "${cells[@]}"; do
      case $name:$cell in
        machine-hall:0.0[0-3]*) ;; # its truth has cells of 32 mm, and its smaller maps take gigabytes
        *) map_row "$name" "$cell" ;;
      esac
    done
  done
}

part_paths() {
  room_map office 0.064
  kept "$results/paths.json" "$bin" evaluate paths "$map" "$source/truth.ot" --json
  echo '| office, 64 mm, unknown as blocked | pairs | blocked | planned | collide in truth |'
  echo '|---|---|---|---|---|'
  for pairs in all observed path_observed; do
    echo "| $pairs | $(value "$results/paths.json" unknown_blocked $pairs pairs)" \
      "| $(digits 3 "$(value "$results/paths.json" unknown_blocked $pairs unreachable)") | $(value "$results/paths.json" unknown_blocked $pairs planned)" \
      "| $(digits 3 "$(value "$results/paths.json" unknown_blocked $pairs false_negative)") |"
  done
}

part_sweep() {
  if [ "$mode" = full ]; then
    MONOGRID=$bin PAGES= scripts/thesis-comparison.sh "$results/sweep" >/dev/null
    cat "$results/sweep/sweep/tables.md"
  else
    room_run office
    "$bin" sweep "$run/recording.mgk" --truth "$source/truth.ot" --align "gt:$source/groundtruth.txt" --resolutions 0.128 \
      --out "$results/sweep" >/dev/null 2>&1
    cat "$results/sweep/tables.md"
  fi
}

part_engine() { verbatim scripts/bench_octomap.sh "$results/engine" "$scans"; }

part_queries() {
  mkdir -p "$results/engine"
  verbatim scripts/bench_queries.sh "$results/engine"
}

part_octomap() {
  plain_run tsukuba
  verbatim crates/monogrid-occupancy/tests/octomap/verify.sh "$results/octomap" "$results/tsukuba-plain/global.ot"
  for test in fused keyframes moving_obstacles; do
    verbatim cargo test --quiet --release -p monogrid-occupancy --test suite "$test::" -- --nocapture
  done
}

part_live() {
  plain_run "$speed_sequence"
  example -p monogrid-studies --example live_maps "$results/$speed_sequence-plain/recording.mgk" "$data/$speed_sequence" frames=100
}

# One line of the table of speed: PROFILE CORES THREADS, the median of the runs by frames per second.
speed_row() {
  local rows=$results/speed-$1-$3.rows run=$results/speed-run seed=()
  if [ "$speed_sequence" = red-kitchen ]; then seed=(--seed-depth dataset); fi
  touch "$rows"
  while [ "$(wc -l <"$rows")" -lt "$speed_runs" ]; do
    rm -f "$run.exit"
    bin=taskset kept_run "$run" -c "$2" "$BIN" run "$data/$speed_sequence" --profile "$1" --resolution 0.02 --threads "$3" \
      ${seed[0]:+"${seed[@]}"}
    echo "$(value "$run.json" frames_per_second) $(value "$run.json" peak_rss_bytes) $(value "$run.json" keyframes)" \
      "$(value "$run.json" frames) $(value "$run.json" tracking) $(value "$run.json" depth) $(value "$run.json" seconds graph)" \
      "$(value "$run.json" mapping) $(value "$run.json" reading) $(value "$run.json" graph_wait_ms)" >>"$rows"
  done
  sort -g "$rows" | awk -v threads="$3" '{ row[NR] = $0 } END {
    split(row[int((NR + 1) / 2)], x, " "); split(row[1], low, " "); split(row[NR], high, " ")
    printf "| %d | %.1f (%.1f to %.1f) | %.0f MB | %.1f | %.1f | %.1f | %.1f | %.1f | %.1f | %.0f ms |\n", threads, x[1], low[1], high[1],
      x[2] / 1e6, x[2] / 1e6 / x[3], 1e3 * x[5] / x[4], 1e3 * x[6] / x[4], 1e3 * x[7] / x[4], 1e3 * x[8] / x[4], 1e3 * x[9] / x[4], x[10]
  }'
}

speed_table() { # PROFILE
  echo "$speed_sequence with mapping at 2 cm and all output files; CPU in ms per frame"
  echo
  echo '| threads | frames per second, median (range) | memory | MB per keyframe | tracking | depth | graph | mapping | reading | longest wait for the graph |'
  echo '|---|---|---|---|---|---|---|---|---|---|'
  speed_row "$1" 0,1 2
  speed_row "$1" 0 1
}

part_speed() { speed_table default; }

part_size() { scripts/size.py; }

part_room() {
  room living-room
  example -p monogrid-studies --example one_room "$source" size=320x240 frames="$room_frames"
}

corridor() { # FRAMES OPTION...: $source
  world corridor-loop "$@"
  source=$results/world-corridor-loop-$1
}

part_loops() {
  corridor "$corridor_frames" ${corridor_options[0]:+"${corridor_options[@]}"}
  echo '| start | ATE | scale drift | closures by appearance |'
  echo '|---|---|---|---|'
  for i in $(seq 0 $((starts - 1))); do
    local run=$results/corridor-$i
    kept_run "$run" run "$source" --seed "$i" --start "$i" --resolution 0.1
    evaluated "$run" "$source" || true
    echo "| $i | $(digits 2 "$(value "$run.ate" ate_rmse)") m | $(digits 4 "$(value "$run.ate" scale_drift)") | $(value "$run.json" loop_closures) |"
  done
  example -p monogrid-graph --example timing
}

part_kidnap() {
  room living-room
  example -p monogrid-studies --example kidnap "$source" "$cases"
  [ "$mode" = quick ] || example -p monogrid-studies --example kidnap "$data/red-kitchen" "$cases"
}

part_fragments() {
  if [ "$mode" = quick ]; then
    room office
    example -p monogrid-studies --example fragments "$source" parts=0-100,200-290
    return
  fi
  for ranges in 0-180,400-700 0-250,450-700; do example -p monogrid-studies --example fragments "$data/red-kitchen" parts="$ranges"; done
  room living-room
  local other=$source
  example -p monogrid-studies --example fragments "$source" parts=0-250,780-1260
  room office
  example -p monogrid-studies --example fragments "$source" parts=0-250,800-1499
  example -p monogrid-studies --example fragments "$source" parts=0-250,OTHER:300-900 OTHER="$other"
  corridor 2000
  example -p monogrid-studies --example fragments "$source" parts=0-400,1000-1999
  example -p monogrid-studies --example fragments "$source" parts=0-400,840-1340 step=2
}

part_sessions() {
  local source=$data/$speed_sequence first=$results/session-first part=400 seed=()
  if [ "$speed_sequence" = red-kitchen ]; then seed=(--seed-depth dataset); else part=80; fi
  kept_run "$first" run "$source" ${seed[0]:+"${seed[@]}"} --max-frames "$part"
  kept_run "$results/session-localise" run "$source" --continue "$first" --localise-only
  kept_run "$results/session-extend" run "$source" --continue "$first"
  echo "| $speed_sequence | keyframes | frames with a pose | ATE | scale drift |"
  echo '|---|---|---|---|---|'
  for name in first localise extend; do
    local run=$results/session-$name
    evaluated "$run" "$source" || true
    echo "| $name | $(value "$run.json" keyframes) | $(value "$run.json" tracked) of $(value "$run.json" frames)" \
      "| $(digits 2 "$(value "$run.ate" ate_rmse)") m | $(digits 3 "$(value "$run.ate" scale_drift)") |"
  done
}

part_odometry() {
  plain_run "$speed_sequence"
  echo "| $speed_sequence | ATE | over one frame |"
  echo '|---|---|---|'
  for name in trajectory trajectory_live trajectory_odometry; do
    local report=$results/$name.json
    kept "$report" "$bin" evaluate trajectory "$results/$speed_sequence-plain/$name.txt" "$data/$speed_sequence/groundtruth.txt" --json
    echo "| $name.txt | $(digits 2 "$(value "$report" ate_rmse)") m | $(digits 2 "$(value "$report" rpe_trans_rmse)") m, $(digits 2 "$(value "$report" rpe_rot_rmse_deg)")° |"
  done
}

part_survey() {
  FRAMES=$world_frames SIZE=$survey_size ROWS=$results/survey.rows scripts/survey.sh ${survey_sequences[0]:+"${survey_sequences[@]}"}
}

# The README's line of a sequence: NAME, what it is.
readme_row() {
  plain_run "$1"
  local run=$results/$1-plain result='no keyframe (exit code 3)' frames tracked drift
  if evaluated "$run" "$data/$1"; then
    frames=$(value "$run.json" frames) tracked=$(value "$run.json" tracked) drift=$(value "$run.ate" scale_drift)
    result="$(digits 2 "$(value "$run.ate" ate_rmse)") m"
    awk -v d="$drift" 'BEGIN { exit !(d > 1.05) }' && result+=", scale drift $(digits 3 "$drift")"
    [ "$frames" = "$tracked" ] || result+=", $(digits 3 "$(awk -v a="$tracked" -v b="$frames" 'BEGIN { print 100 * a / b }')") % of the frames"
  fi
  echo "| $1, $(promised "$1" what) | $(others "$1") | $result |"
}

part_readme() {
  echo '| sequence | ORB-SLAM3 | COLMAP | C++ LSD-SLAM | DSO | monogrid |'
  echo '|---|---|---|---|---|---|'
  local sequence
  for sequence in red-kitchen fr1-desk tsukuba icl-office icl-office-kt3 kitti-forward kitti-07 euroc-static; do
    readme_row "$sequence"
  done
  demo_run
  local run=$results/demo.json
  echo "| demo, rendered, $(value "$run" frames) frames, $(digits 2 "$(value "$run" trajectory path_length)") m | – | – | – | –" \
    "| $(digits 2 "$(value "$run" trajectory ate_rmse)") m; map against the truth: AUC $(digits 2 "$(value "$run" map_error observed auc)")," \
    "MCC $(digits 2 "$(value "$run" map_error observed mcc)") |"
  cp "$results/demo/preview.png" docs/preview.png
}

# What the first commands of README.md take, from the first frame to the last file.
part_first() {
  echo '| command | time, s | frames | with a pose |'
  echo '|---|---|---|---|'
  local name run video=$data/phone-desk/video.mp4
  for name in 'demo --max-frames 300' 'check video.mp4' 'run video.mp4'; do
    run=$results/first-${name%% *}
    local words=(${name//video.mp4/$video}) start=$EPOCHREALTIME
    case $name in
      check*) "$bin" "${words[@]}" --json >"$run.json" ;;
      *) rm -rf "$run" && "$bin" "${words[@]}" --out "$run" --json >"$run.json" 2>"$run.log" ;;
    esac
    local seconds tracked=–
    seconds=$(awk -v a="$start" -v b="$EPOCHREALTIME" 'BEGIN { printf "%.0f", b - a }')
    [[ $name == check* ]] || tracked=$(value "$run.json" tracked)
    echo "| \`monogrid $name\` | $seconds | $(value "$run.json" frames) | $tracked |"
  done
}

# A single part is made here; several each by this script again, so that one that fails does not end the others.
if [ ${#wanted[@]} -eq 1 ]; then
  part=${wanted[0]}
  declare -F "part_$part" >/dev/null || { echo "no part $part; known are: ${parts[*]} readme" >&2; exit 2; }
  file=$results/$part.md
  if [ ! -f "$file" ]; then
    "part_$part" >"$file.part"
    mv "$file.part" "$file"
  fi
  cat "$file"
  if [ "$mode" = full ] && [ -n "${COMMIT:-}" ]; then scripts/results.py collect "$results" "$part"; fi
  exit 0
fi
failed=()
for part in "${wanted[@]}"; do
  printf '\n## %s\n\n' "$part"
  "$0" "$mode" "$part" || failed+=("$part")
done
[ ${#failed[@]} -eq 0 ] || { echo "failed: ${failed[*]}; start again to go on" >&2; exit 1; }
