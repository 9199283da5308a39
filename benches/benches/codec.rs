//! Encoding of a setpoint and decoding of a state, for one motor.

use criterion::{Criterion, criterion_group, criterion_main};
use motord_protocol::Scales;
use motord_protocol::mit::{Asked, Command, Impedance};
use motord_protocol::profile::STEADYWIN;
use std::hint::black_box;

fn codec(criterion: &mut Criterion) {
    let scales = Scales::by_current(0.125, 8.0).expect("the constants of a GIM8108-8 are sound");
    let setpoint = Impedance { position: 0.4, velocity: -1.5, kp: 60.0, kd: 1.5, torque: 3.0 };
    let command = Command::Control(setpoint);
    let reply = [0x01, 0x83, 0x12, 0x7F, 0x48, 0x2A];

    let mut group = criterion.benchmark_group("codec");
    group.bench_function("encode a control frame", |bencher| {
        bencher.iter(|| black_box(&command).encode(black_box(&scales)));
    });
    group.bench_function("decode a state", |bencher| {
        bencher.iter(|| STEADYWIN.decode(black_box(&reply), Asked::State, black_box(&scales)));
    });
    group.finish();
}

criterion_group!(benches, codec);
criterion_main!(benches);
