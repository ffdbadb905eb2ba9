use super::*;

/// What all operations give for pairs of numbers, as bits.
#[inline(always)]
fn all_operations<L: Lanes>(lanes: L, a: [f32; 8], b: [f32; 8]) -> Vec<[u32; 8]> {
    let (x, y) = (lanes.f32s(&a), lanes.f32s(&b));
    let number = b[3];
    let floats = [
        x + y,
        x - y,
        x * y,
        x / y,
        -x,
        x + number,
        x - number,
        x * number,
        x / number,
        x.gt(y),
        x.ge(y),
        x.lt(y),
        x.le(y),
        x.min(y),
        x.max(y),
        (x * x).sqrt(),
        x.gt(y).select(x, y),
        x.le(y) & x,
        lanes.splat(x.sum()),
        lanes.splat(x.gt(y).bits() as f32),
    ];
    let (i, j) = (x.truncated(), y.truncated());
    let integers = [
        i,
        i + j,
        i - j,
        i & j,
        i.shl::<3>(),
        i.shr::<2>(),
        i.to_f32().truncated(),
        lanes.products(&i.to_i16(), &j.to_i16()),
    ];
    let floats = floats.map(|v| v.to_array().map(f32::to_bits));
    let integers = integers.map(|v| v.to_array().map(|lane| lane as u32));
    floats.into_iter().chain(integers).collect()
}

for_lanes! {
    fn on_the_widest = all_operations, (a: [f32; 8], b: [f32; 8]) -> Vec<[u32; 8]>;
}

#[test]
fn operations_are_what_they_say() {
    let (a, b) = (
        [1.5, -2.25, 3.0, 0.0, 7.75, -8.0, 9.5, -0.5],
        [1.0, 2.0, 3.0, 4.0, -5.0, 6.0, -7.0, 8.0],
    );
    let found = all_operations(Baseline, a, b);
    let expected = |of: fn(f32, f32) -> f32| -> [u32; 8] {
        std::array::from_fn(|lane| of(a[lane], b[lane]).to_bits())
    };
    let mask = |set: bool| f32::from_bits(if set { u32::MAX } else { 0 });
    assert_eq!(found[0], expected(|a, b| a + b));
    assert_eq!(found[3], expected(|a, b| a / b));
    assert_eq!(found[4], expected(|a, _| -a));
    assert_eq!(found[7], expected(|a, _| a * 4.0));
    assert_eq!(
        found[9],
        std::array::from_fn(|l| mask(a[l] > b[l]).to_bits())
    );
    assert_eq!(found[13], expected(f32::min));
    assert_eq!(found[16], expected(f32::max));
    assert_eq!(found[18], [11.0f32.to_bits(); 8]);
    assert_eq!(found[19], [0b0101_0001_u32 as f32; 8].map(f32::to_bits));
    let integer = |l: usize| (a[l] as i32, b[l] as i32);
    assert_eq!(
        found[25],
        std::array::from_fn(|l| (integer(l).0 >> 2) as u32)
    );
    assert_eq!(
        found[27],
        std::array::from_fn(|l| (integer(l).0 * integer(l).1) as u32)
    );
}

#[test]
fn all_vectors_give_the_same_bits() {
    let mut state = 7_u64;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005) + 1;
        (state >> 40) as f32 / 65536.0 - 128.0
    };
    for round in 0..200 {
        let mut a: [f32; 8] = std::array::from_fn(|_| next());
        let b: [f32; 8] = std::array::from_fn(|_| next());
        if round % 10 == 0 {
            (a[1], a[6]) = (b[1], 0.0);
        }
        assert_eq!(on_the_widest(a, b), all_operations(Baseline, a, b));
    }
    // what is no number has no bits that are promised after arithmetic: where one of two is none,
    // it is the one that stays
    let (none, far) = (f32::NAN, f32::INFINITY);
    let odd = [none, -0.0, 0.0, far, -far, 3e9, -70000.0, 1e-40];
    for shift in 1..8 {
        let mut others = odd;
        others.rotate_left(shift);
        others[3] = 2.0;
        assert_eq!(
            on_the_widest(odd, others),
            all_operations(Baseline, odd, others),
            "{shift}"
        );
    }
}
