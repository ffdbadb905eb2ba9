//! `.ot` and `.bt` against files that OctoMap wrote (`tests/octomap/make_golden.cpp`), and
//! against damage.
#![allow(clippy::unwrap_used, reason = "a test fails where it unwraps")]

use monogrid_occupancy::*;

const BUDGET: usize = 64 << 20;

fn golden(name: &str) -> Vec<u8> {
    std::fs::read(format!(
        "{}/tests/golden/{name}",
        env!("CARGO_MANIFEST_DIR")
    ))
    .unwrap()
}

/// The leaves as OctoMap listed them: first cell, edge, log-odds.
fn listed_leaves() -> Vec<([i32; 3], u32, f32)> {
    String::from_utf8(golden("golden.txt"))
        .unwrap()
        .lines()
        .map(|line| {
            let words: Vec<&str> = line.split(' ').collect();
            let key = [0, 1, 2].map(|i| words[i].parse().unwrap());
            (key, words[3].parse().unwrap(), words[4].parse().unwrap())
        })
        .collect()
}

fn write(
    map: &OccupancyMap,
    writer: fn(&OccupancyMap, &mut Vec<u8>) -> Result<(), MapError>,
) -> Vec<u8> {
    let mut bytes = Vec::new();
    writer(map, &mut bytes).unwrap();
    bytes
}

#[test]
fn leaves_of_octomaps_ot_are_those_that_octomap_lists() {
    let map = read_ot(&golden("golden.ot")[..], BUDGET).unwrap();
    let mut expected = listed_leaves();
    expected.sort_by_key(|l| l.0);
    assert_eq!(expected.len(), 1045);
    let mut leaves = map.octree_leaves().unwrap();
    leaves.sort();
    assert_eq!(leaves.len(), expected.len());
    assert_eq!(map.leaf_count(), expected.len());
    for (leaf, (key, edge, log_odds)) in leaves.iter().zip(expected) {
        assert_eq!(leaf.first.to_array(), key);
        assert_eq!(leaf.edge_cells, edge);
        assert!(
            (leaf.log_odds() - log_odds).abs() <= 0.5 / 4096.0,
            "{leaf:?} {log_odds}"
        );
    }
}

#[test]
fn leaves_of_octomaps_bt_have_the_sides_that_octomap_lists() {
    let map = read_bt(&golden("golden.bt")[..], BUDGET).unwrap();
    let mut cells = 0;
    for (key, edge, log_odds) in listed_leaves() {
        for offset in 0..edge.pow(3) {
            let [x, y, z] = [offset % edge, offset / edge % edge, offset / edge / edge];
            let cell = VoxelKey::new(key[0] + x as i32, key[1] + y as i32, key[2] + z as i32);
            let expected = if log_odds >= 0.0 {
                Occupancy::Occupied
            } else {
                Occupancy::Free
            };
            assert_eq!(map.state_of(cell), expected, "{cell:?}");
            cells += 1;
        }
    }
    assert_eq!(map.cells().count(), cells, "and no other cell is known");
}

#[test]
fn written_files_are_byte_for_byte_octomaps_where_values_are_exact() {
    // .bt holds no values: the bytes must be OctoMap's own.
    let from_ot = read_ot(&golden("golden.ot")[..], BUDGET).unwrap();
    assert_eq!(write(&from_ot, write_bt), golden("golden.bt"));
    // .ot values are rounded to 1/4096 when read; everything else must be the same.
    let (ours, theirs) = (write(&from_ot, write_ot), golden("golden.ot"));
    assert_eq!(ours.len(), theirs.len());
    let header = theirs.windows(5).position(|w| w == b"data\n").unwrap() + 5;
    assert_eq!(ours[..header], theirs[..header]);
    for (a, b) in ours[header..].chunks(5).zip(theirs[header..].chunks(5)) {
        assert_eq!(a[4], b[4], "children");
        let value = |node: &[u8]| f32::from_le_bytes(node[..4].try_into().unwrap());
        assert!((value(a) - value(b)).abs() <= 0.5 / 4096.0);
    }
}

#[test]
fn maps_survive_both_formats_and_their_writing_changes_nothing() {
    let map = read_ot(&golden("golden.ot")[..], BUDGET).unwrap();
    let before = map.clone();
    let again = read_ot(&write(&map, write_ot)[..], BUDGET).unwrap();
    assert!(again == map);
    let bt = write(&map, write_bt);
    assert!(map == before, "writing .bt leaves the map alone");
    let from_bt = read_bt(&bt[..], BUDGET).unwrap();
    assert_eq!(write(&from_bt, write_bt), bt);
    let states = |m: &OccupancyMap| m.cells().map(|c| (c.key, c.state)).collect::<Vec<_>>();
    assert_eq!(states(&from_bt), states(&map));
}

#[test]
fn an_empty_map_is_a_file_and_comes_back_empty() {
    let map = OccupancyMap::new(MapConfig::with_resolution(0.02)).unwrap();
    let ot = read_ot(&write(&map, write_ot)[..], BUDGET).unwrap();
    let bt = read_bt(&write(&map, write_bt)[..], BUDGET).unwrap();
    assert!(ot.is_empty() && bt.is_empty());
    assert_eq!(ot.resolution(), 0.02);
    assert_eq!(map.leaf_count(), 0);
}

#[test]
fn cells_beyond_octomaps_keys_are_an_error_not_a_wrapped_map() {
    let mut map = OccupancyMap::new(MapConfig::with_resolution(0.01)).unwrap();
    map.add_log_odds(VoxelKey::new(32767, -32768, 0), 1.0)
        .unwrap();
    let bytes = write(&map, write_ot);
    assert!(read_ot(&bytes[..], BUDGET).unwrap() == map);
    map.add_log_odds(VoxelKey::new(32768, 0, 0), 1.0).unwrap();
    assert!(matches!(
        write_ot(&map, &mut Vec::new()),
        Err(MapError::OutOfOctomapRange { .. })
    ));
}

#[test]
fn truncated_and_mutated_files_give_errors_or_maps_but_never_a_panic() {
    type Reader = fn(&[u8]) -> Result<OccupancyMap, MapError>;
    let readers: [(&str, Reader); 2] = [
        ("golden.ot", |b| read_ot(b, BUDGET)),
        ("golden.bt", |b| read_bt(b, BUDGET)),
    ];
    for (name, read) in readers {
        let file = golden(name);
        for end in (0..file.len() - 1).step_by(37) {
            assert!(
                read(&file[..end]).is_err(),
                "{name} cut at {end} was accepted"
            );
        }
        let mut state = 11_u32;
        for _ in 0..600 {
            let mut bytes = file.clone();
            for _ in 0..3 {
                state = state.wrapping_mul(1664525).wrapping_add(1013904223);
                let at = (state >> 8) as usize % bytes.len();
                bytes[at] ^= 1 << (state & 7);
            }
            if let Ok(map) = read(&bytes) {
                assert!(map.bytes_in_memory() <= BUDGET);
            }
        }
    }
}

/// The tree of a `.bt`, without its header.
fn tree_of(map: &OccupancyMap) -> (Vec<u8>, usize) {
    let mut file = Vec::new();
    write_bt(map, &mut file).unwrap();
    let data = b"\ndata\n";
    let at = file.windows(data.len()).position(|w| w == data).unwrap();
    (
        file[at + data.len()..].to_vec(),
        map.octree_node_count().unwrap(),
    )
}

fn small_map() -> OccupancyMap {
    let mut map = OccupancyMap::new(MapConfig::with_resolution(0.2)).unwrap();
    for x in 0..20 {
        let log_odds = if x % 3 == 0 { 3.0 } else { -3.0 };
        map.set_log_odds(VoxelKey::new(x, -2 * x, 1), Some(log_odds))
            .unwrap();
    }
    map
}

fn states(map: &OccupancyMap) -> Vec<(VoxelKey, bool)> {
    let cells = map.cells().map(|cell| (cell.key, cell.log_odds > 0.0));
    cells.collect()
}

#[test]
fn trees_of_other_names_and_of_old_versions_are_read() {
    let map = small_map();
    let (tree, nodes) = tree_of(&map);
    for id in ["OcTree", "OcTreeStamped", "ColorOcTree", "1"] {
        let header =
            format!("# Octomap OcTree binary file\nid {id}\nsize {nodes}\nres 0.2\ndata\n");
        let file = [header.as_bytes(), &tree].concat();
        let read = read_bt(&file[..], usize::MAX).unwrap();
        assert_eq!(states(&read), states(&map), "{id}");
    }
    let size = (nodes as u32).to_le_bytes();
    let old = [
        &[3, 0, 0, 0],
        0.2_f64.to_le_bytes().as_slice(),
        &size,
        &tree,
    ]
    .concat();
    let (read, format) = read_map(&old[..], old.len() as u64).unwrap();
    assert_eq!((states(&read), format), (states(&map), MapFormat::Bt));
    assert_eq!(read.resolution(), 0.2);
    for end in 0..old.len() {
        assert!(read_bt(&old[..end], usize::MAX).is_err(), "{end}");
    }
    let mut full = Vec::new();
    write_ot(&map, &mut full).unwrap();
    let stamped = String::from_utf8_lossy(&full[..200])
        .find("id OcTree\n")
        .unwrap();
    full.splice(stamped + 9..stamped + 9, *b"Stamped");
    assert_eq!(
        states(&read_ot(&full[..], usize::MAX).unwrap()),
        states(&map)
    );
    let counting = b"# Octomap OcTree file\nid CountingOcTree\nsize 1\nres 0.2\ndata\n";
    let error = read_ot(&counting[..], usize::MAX).unwrap_err().to_string();
    assert!(error.contains("CountingOcTree"), "{error}");
}

/// A node of a `ColorOcTree`: first cell and edge, log-odds, colour, whether it has children.
type ColourNode = ([i32; 3], i32, f32, [u8; 3], bool);

/// All nodes of the tree in a file, as OctoMap's documentation describes it.
fn colour_nodes(file: &[u8]) -> Vec<ColourNode> {
    fn node(bytes: &mut &[u8], first: [i32; 3], edge: i32, nodes: &mut Vec<ColourNode>) {
        let (head, rest) = bytes.split_at(8);
        *bytes = rest;
        let log_odds = f32::from_le_bytes(head[..4].try_into().unwrap());
        let [.., children] = head else { unreachable!() };
        let colour = head[4..7].try_into().unwrap();
        nodes.push((first, edge, log_odds, colour, *children != 0));
        for octant in (0..8).filter(|octant| children >> octant & 1 == 1) {
            let half = edge / 2;
            let moved = [0, 1, 2].map(|axis| first[axis] + half * (octant >> axis & 1));
            node(bytes, moved, half, nodes);
        }
    }
    let data = b"\ndata\n";
    let at = file.windows(data.len()).position(|w| w == data).unwrap();
    let (mut bytes, mut nodes) = (&file[at + data.len()..], Vec::new());
    node(&mut bytes, [-32768; 3], 65536, &mut nodes);
    assert!(bytes.is_empty());
    nodes
}

#[test]
fn a_tree_in_colour_has_the_colours_of_its_cells_and_their_mean_above() {
    let mut map = small_map();
    // eight equal cells, which are one leaf
    for [x, y, z] in (0..8).map(|k| [-40 + (k & 1), 6 + (k >> 1 & 1), 10 + (k >> 2)]) {
        map.set_log_odds(VoxelKey::new(x, y, z), Some(3.0)).unwrap();
    }
    let red = (VoxelKey::new(0, 0, 1), [200, 10, 20]);
    let colours = [
        red,
        (VoxelKey::new(-40, 6, 10), [0, 0, 0]),
        (VoxelKey::new(-39, 7, 11), [100, 50, 25]),
    ];
    let mut file = Vec::new();
    write_colour_ot(&map, colours, &mut file).unwrap();
    assert!(file.starts_with(b"# Octomap OcTree file\n"));
    let text = String::from_utf8_lossy(&file[..200]).into_owned();
    assert!(text.contains("\nid ColorOcTree\n"), "{text}");
    assert_eq!(
        states(&read_ot(&file[..], usize::MAX).unwrap()),
        states(&map)
    );
    let nodes = colour_nodes(&file);
    assert!(
        text.contains(&format!("\nsize {}\n", nodes.len())),
        "{text}"
    );
    let colour_of = |first: [i32; 3], edge: i32| {
        let found = nodes.iter().find(|n| (n.0, n.1) == (first, edge));
        found.map(|n| (n.3, n.4))
    };
    assert_eq!(colour_of([0, 0, 1], 1), Some((red.1, false)));
    // a cell without a colour
    assert_eq!(colour_of([3, -6, 1], 1), Some(([255; 3], false)));
    assert_eq!(colour_of([-40, 6, 10], 2), Some(([50, 25, 13], false)));
    assert_eq!(colour_of([-32768; 3], 65536), Some(([100, 20, 15], true)));
}

#[test]
fn eighths_of_all_space_that_are_free_are_left_out_and_counted() {
    // a root with seven free leaves, and one octant down to a cell
    let mut file = b"# Octomap OcTree file\nid OcTree\nsize 24\nres 0.1\ndata\n".to_vec();
    let mut node = |log_odds: f32, children: u8| {
        file.extend(log_odds.to_le_bytes());
        file.push(children);
    };
    node(1.0, 0xff);
    (0..7).for_each(|_| node(-1.0, 0));
    (1..16).for_each(|_| node(1.0, 1));
    node(1.0, 0);
    let map = read_ot(&file[..], 1 << 20).unwrap();
    assert_eq!((map.endless_free(), map.cells().count()), (7, 1));
    // occupied ones cannot be left out
    let at = file.len() - 5 * 22;
    file[at..at + 4].copy_from_slice(&1.0_f32.to_le_bytes());
    assert!(read_ot(&file[..], 1 << 20).is_err());
}

#[test]
fn a_tiny_file_that_claims_the_whole_world_does_not_fill_the_memory() {
    let mut file = b"# Octomap OcTree file\nid OcTree\nsize 1\nres 0.1\ndata\n".to_vec();
    file.extend(1.0_f32.to_le_bytes());
    file.push(0);
    assert!(matches!(
        read_ot(&file[..], BUDGET),
        Err(MapError::MemoryBudget { .. })
    ));
    for (file, wanted) in [
        (&b"ply\n"[..], "first line"),
        (
            &b"# Octomap OcTree file\nid OcTree\nsize 1\nres -1\ndata\n"[..],
            "resolution",
        ),
        (
            &b"# Octomap OcTree file\nid Cone\nsize 1\nres 1\ndata\n"[..],
            "Cone",
        ),
        (&b"# Octomap OcTree file\nsize many\n"[..], "size many"),
    ] {
        let message = read_ot(file, BUDGET).unwrap_err().to_string();
        assert!(
            message.contains(wanted),
            "{message:?} should mention {wanted:?}"
        );
    }
}

#[test]
fn point_clouds_hold_every_occupied_cell() {
    let map = read_ot(&golden("golden.ot")[..], BUDGET).unwrap();
    let occupied = map
        .cells()
        .filter(|c| c.state == Occupancy::Occupied)
        .count();
    let ply = write(&map, |map, out| write_ply(map, None, out));
    let coloured = write(&map, |map, out| {
        write_ply(map, Some(&|key| [key.x as u8, 7, 9]), out)
    });
    assert_eq!(coloured[coloured.len() - 2..], [7, 9]);
    let pcd = write(&map, write_pcd);
    for (bytes, marker) in [(ply, &b"end_header\n"[..]), (pcd, &b"DATA binary\n"[..])] {
        let start = bytes
            .windows(marker.len())
            .position(|w| w == marker)
            .unwrap()
            + marker.len();
        assert_eq!((bytes.len() - start) / 16, occupied);
        for point in bytes[start..].chunks(16) {
            let value = |i: usize| f32::from_le_bytes(point[4 * i..4 * i + 4].try_into().unwrap());
            let at = [0, 1, 2].map(|i| f64::from(value(i)));
            assert_eq!(map.state(at), Occupancy::Occupied);
            assert!((0.5..=1.0).contains(&value(3)));
        }
    }
}

#[test]
fn a_failed_save_leaves_the_old_file_whole() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map.ot");
    std::fs::write(&path, b"old").unwrap();
    let failed = save_atomically(&path, |file| {
        std::io::Write::write_all(file, b"half").unwrap();
        Err(MapError::Resolution { value: 0.0 })
    });
    assert!(failed.is_err());
    assert_eq!(std::fs::read(&path).unwrap(), b"old");
    save_atomically(&path, |file| {
        std::io::Write::write_all(file, b"new").map_err(|source| MapError::Io {
            action: "writing",
            source,
        })
    })
    .unwrap();
    assert_eq!(std::fs::read(&path).unwrap(), b"new");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}
