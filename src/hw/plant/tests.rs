//! What the plant must do as a whole.

use super::testing::{TestServo, held};
use super::*;

#[test]
fn probe() {
    let config = held(Jaws::rubber(), CubeMechanics::of_2007());
    let mut servo = TestServo::new(Plant::new(config, 1).unwrap());
    servo.jaws[0] = (0.055, 30.0);
    let show = |s: &TestServo, what: &str| {
        let v = s.plant.verdict();
        let t = s.plant.balance.touches;
        println!(
            "{what}: {:?} pads {:?} {:?} f {:?} {:?} peak {:.2} N {:.3} Nm split {:?} angles {:?}",
            v.cube,
            t[0].pads,
            t[1].pads,
            t[0].force.as_slice(),
            t[1].force.as_slice(),
            v.peak_force,
            v.peak_torque,
            s.plant.balance.split,
            v.layer_angles
        );
        for e in &v.events {
            println!("   {e:?}");
        }
    };
    show(&servo, "start");
    let start = servo.plant.arms[0].world_from_tool.p;
    servo.run(0.5);
    println!("{:?}", servo.plant.arms[0].world_from_tool.p - start);
    show(&servo, "0.5 s");
    servo.jaws[1] = (0.055, 30.0);
    servo.run(2.5);
    println!("openings {} {}", servo.plant.jaws[0].opening(), servo.plant.jaws[1].opening());
    show(&servo, "closed");
    // Turn the postument's last joint by a quarter in 4 s.
    let from = servo.joints(1);
    for k in 0..2000 {
        let mut q = from;
        q.0[6] -= f64::from(k + 1) / 2000.0
            * std::f64::consts::FRAC_PI_2
            * if from.0[6] > 0.0 { 1.0 } else { -1.0 };
        servo.aim(1, &q);
        servo.tick();
        if k % 250 == 0 {
            println!(
                "{k} turned {:.2} deg torque {:.3} limit {:.3}",
                servo.plant.verdict.turned.to_degrees(),
                servo.plant.balance.interface.torque,
                servo.plant.balance.interface.limit
            );
        }
    }
    servo.run(0.3);
    show(&servo, "turned");
    let t0 = std::time::Instant::now();
    servo.run(4.0);
    println!("both hold: {:.2} us a tick", t0.elapsed().as_secs_f64() / 2000.0 * 1e6);
    servo.jaws[0] = (0.088, 30.0);
    servo.run(2.0);
    show(&servo, "track opened");
    let t0 = std::time::Instant::now();
    servo.run(4.0);
    println!("one holds: {:.2} us a tick", t0.elapsed().as_secs_f64() / 2000.0 * 1e6);
    servo.jaws[1] = (0.088, 30.0);
    servo.run(2.0);
    show(&servo, "dropped");
    let t0 = std::time::Instant::now();
    servo.run(4.0);
    println!("none holds: {:.2} us a tick", t0.elapsed().as_secs_f64() / 2000.0 * 1e6);
}
