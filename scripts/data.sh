#!/usr/bin/env bash
# The recordings of the tables: where each comes from, under which licence, how it was cut, and whether the one that is
# here is the one that was measured.
#
#   scripts/data.sh                   the names
#   scripts/data.sh NAME...           what is known of a recording, and whether it is here
#   scripts/data.sh all               of all of them
#   scripts/data.sh --fetch NAME      fetches one whose licence allows it, as it is published (needs curl and tar)
#
# Recordings lie in the folder that MONOGRID_DATA names, each in a folder of its own. The checksum is that of the list of
# SHA-256 of all files in the order of their names. Recordings of the tables are cut and partly encoded anew, to be small;
# what is fetched as it is published has the same frames, and numbers differ in their last digits. Nothing of this is part
# of the project: the licences are those of the recordings.
set -euo pipefail
cd "$(dirname "$0")/.."

names=(red-kitchen icl-office icl-office-kt3 tsukuba kitti-forward kitti-07 fr1-desk euroc-static phone-desk box-rgbd videos
  trajectories)
tum=https://cvg.cit.tum.de/rgbd/dataset
icl=https://www.doc.ic.ac.uk/~ahanda

# describe NAME: source, licence, cut, checksum, and how it is fetched (nothing where a script may not, or cannot)
describe() {
  fetched='by hand'
  case $1 in
    red-kitchen)
      source='7-Scenes, RedKitchen (Microsoft Research, https://www.microsoft.com/en-us/research/project/rgb-d-dataset-7-scenes/)'
      licence='non-commercial research; accept it there'
      cut='700 frames of one sequence, colour as JPEG, every 5th depth image, poses as groundtruth.txt; calibration ours, by structure from motion'
      sum=5fd7d84d88eacb0271bb01fdfc9c905c5bf94b441182e50838443e0b132126a1 ;;
    icl-office)
      source='the office of ICL-NUIM (Imperial College London), ray-traced by us along a hand-held motion'
      licence='CC BY 3.0'
      cut='54 frames of 640x480 at 20 Hz, exact depth every 8th frame'
      sum=a8274883a392c906a998d9a93f1f4ef29bc59a84f92e6c816a1559b488e21c95 ;;
    icl-office-kt3)
      source="ICL-NUIM, office, trajectory 3, without noise ($icl/VaFRIC/iclnuim.html)"
      licence='CC BY 3.0'
      cut='all 1241 frames, grey, as JPEG; exact depth every 20th frame; the second focal length positive'
      sum=0cd07327c9983e17703de57b95d851a5bdf31eb14c322f1f4dc7b79c375ed776
      fetched="$icl/traj3_frei_png.tar.gz" ;;
    tsukuba)
      source='New Tsukuba Stereo Dataset (CVLAB, University of Tsukuba)'
      licence='asked for at its site, with a registration'
      cut='150 frames of the left camera, poses in metres; the files are JPEG, whatever their names say'
      sum=5756d6de88299ba0abdeb6f3ef29bc5306735f191ab6432f46ff915212c44a69 ;;
    kitti-forward | kitti-07)
      source='KITTI odometry, grey, left camera (https://www.cvlibs.net/datasets/kitti/eval_odometry.php)'
      licence='CC BY-NC-SA 3.0; asked for at its site, with a registration'
      case $1 in
        kitti-forward)
          cut='51 frames of a car that drives straight ahead, as they are published'
          sum=b02d35f0dc5f0a6c65621334fdc27a2c0daa5067b63f339f1fc286fd7ac7bc34 ;;
        *)
          cut='the first 160 frames of sequence 07, as JPEG'
          sum=feb3b78a03d39ddd2ae74b994df82c7c859bedb76ae61703da986480252c464a ;;
      esac ;;
    fr1-desk)
      source="TUM RGB-D, freiburg1_desk ($tum)"
      licence='CC BY 4.0'
      cut='all 613 frames, as JPEG; every 10th depth image'
      sum=285491b54189123fdc6d9d017da9dc816ea299c705282c29777195a458033103
      fetched="$tum/freiburg1/rgbd_dataset_freiburg1_desk.tgz" ;;
    euroc-static)
      source='EuRoC MAV, V1_01_easy (ETH Zurich, https://projects.asl.ethz.ch/datasets/doku.php?id=kmavvisualinertialdatasets)'
      licence='as its site says; cite the data set'
      cut='30 frames of cam0 before take-off'
      sum=2dc9e08a59845ede92fb3749c4abf12b0c25b5e674de16e64704f87d09e1cf27 ;;
    phone-desk)
      source='a video of a desk by a phone, H.264 High with B frames, 364x674, 22.8 s; its origin is not recorded'
      licence='not recorded: it is not passed on. Any video of a phone says the same'
      cut='none'
      sum=4deeb733aba2cc0773995bb626ab202079f2da1df67f19da8f588dbbee875059 ;;
    box-rgbd)
      source='the example of tsdf-fusion (https://github.com/andyzeng/tsdf-fusion)'
      licence='BSD 2-Clause'
      cut='50 frames of colour and depth with poses, in the layout of 7-Scenes. Validation: it chooses nothing'
      sum=fe2df071ba44343a567046a450790b168fc93a8a26fbf0cec7141e1f273bc367
      fetched=https://github.com/andyzeng/tsdf-fusion/archive/refs/heads/master.tar.gz ;;
    videos)
      source='BoofCV-Data (tree-snow, log-building, night-display), AlvaAR of alanross (white-desk), Udacity (freeway), dashcam-turn'
      licence='CC BY-SA 4.0 (BoofCV-Data), MIT (Udacity); of the others as their repositories say'
      cut='60 to 700 frames of each; true poses by COLMAP. Validation: they choose nothing'
      sum=ce1927b2e7a7262328d30bed7f421a531ea186a748887889b4a8e8d5fca56fe4 ;;
    trajectories)
      source='poses without images: TUM RGB-D fr1/xyz and fr2/desk, EuRoC V1_02'
      licence='CC BY 4.0 (TUM); EuRoC as its site says'
      cut='whole'
      sum=75ac8f2d791ce1475581a556a529eea453ddcd58960b88eae9fdeffd5eeac561 ;;
    *)
      echo "found $1, expected one of: ${names[*]}" >&2
      return 2 ;;
  esac
}

# The checksum of a folder.
checksum() {
  (cd "$1" && find . -type f -print0 | LC_ALL=C sort -z | xargs -0 sha256sum | sha256sum | cut -d' ' -f1)
}

show() {
  describe "$1"
  printf '%s\n  source:   %s\n  licence:  %s\n  cut:      %s\n  checksum: %s\n  fetched:  %s\n' \
    "$1" "$source" "$licence" "$cut" "$sum" "$fetched"
  if [ -z "${MONOGRID_DATA:-}" ]; then
    echo '  here:     not looked for: MONOGRID_DATA names no folder'
  elif [ ! -d "$MONOGRID_DATA/$1" ]; then
    echo "  here:     no, $MONOGRID_DATA has no $1"
  elif [ "$(checksum "$MONOGRID_DATA/$1")" = "$sum" ]; then
    echo '  here:     yes, the recording of the tables'
  else
    echo '  here:     yes, but not file by file that of the tables: numbers differ in their last digits'
  fi
}

fetch() {
  describe "$1"
  case $fetched in
    http*) ;;
    *) echo "$1 is not fetched by a script: $licence ($source)" >&2 && return 1 ;;
  esac
  local folder=${MONOGRID_DATA:?names no folder for recordings}/$1
  [ ! -e "$folder" ] || { echo "$folder exists: nothing is fetched" >&2 && return 1; }
  mkdir -p "$folder.part"
  # as it comes, so that nothing but the recording is on the disk
  curl --fail --location --proto '=https' "${MIRROR:-$fetched}" ${MIRROR:+--proto =file} \
    | tar -xz -C "$folder.part" --no-same-owner
  # the folder that the archive is in, if it is in one
  local within=$folder.part
  case $1 in
    fr1-desk)
      within=$(find "$folder.part" -maxdepth 1 -name 'rgbd_dataset*' | head -1)
      echo '517.3 516.5 318.6 255.3 0.2624 -0.9531 -0.0054 0.0026 1.1633 640 480' >"$within/calibration.txt" ;;
    box-rgbd)
      within=$(find "$folder.part" -path '*/data/rgbd-frames' -type d | head -1)
      cp "$within/../camera-intrinsics.txt" "$within/intrinsics.K.txt" ;;
  esac
  mv "$within" "$folder"
  rm -rf "$folder.part"
  echo "$folder"
}

case ${1:-} in
  '') printf '%s\n' "${names[@]}" ;;
  --fetch) fetch "${2:?NAME is missing}" ;;
  all) for name in "${names[@]}"; do show "$name"; done ;;
  *) for name in "$@"; do show "$name"; done ;;
esac
