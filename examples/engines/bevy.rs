//! A spinning body in Bevy: a system that rotates entities by the file that `kreisel code` writes.
//!
//!     kreisel code free-body --set I=1,2,2.5 --language rust --convention bevy --name rock > src/rock.rs
//!
//! The principal axes of a body are the axes of its `Transform`; torques are N m along them.
use crate::rock;
use bevy::prelude::*;

/// The rotation of one body, beside its `Transform`.
#[derive(Component)]
pub struct Spin {
    constants: rock::Constants,
    state: rock::State,
    pub torque: [f64; 3],
}

impl Spin {
    /// Moments in kg m^2, angular velocity in rad/s, the step of `FixedUpdate` in s.
    pub fn new(moments: [f64; 3], rate: [f64; 3], attitude: Quat, dt: f64) -> Result<Spin, &'static str> {
        let status = rock::check(&moments, dt);
        if status != 0 {
            return Err(rock::message(status));
        }
        let mut spin = Spin { constants: Default::default(), state: Default::default(), torque: [0.0; 3] };
        rock::prepare(&mut spin.constants, &moments, dt);
        spin.state.M = [0, 1, 2].map(|k| moments[k] * rate[k]);
        spin.state.g = attitude.to_array().map(f64::from);
        Ok(spin)
    }

    /// A blow: torque times time, N m s.
    pub fn push(&mut self, time: f64) {
        for k in 0..3 {
            self.state.M[k] += time * self.torque[k];
        }
    }
}

/// In the app: `.add_systems(FixedUpdate, rotate)`.
pub fn rotate(mut bodies: Query<(&mut Spin, &mut Transform)>) {
    for (mut spin, mut transform) in &mut bodies {
        let half = 0.5 * spin.constants.h;
        spin.push(half);
        let Spin { constants, state, .. } = &mut *spin;
        rock::step(constants, state);
        transform.rotation = Quat::from_array(state.g.map(|x| x as f32));
        spin.push(half);
    }
}
