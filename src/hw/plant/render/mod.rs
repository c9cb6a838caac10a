//! Renderer of the plant's cameras: a ray caster with the faults of real lenses and sensors.
//!
//! - in: a [`Scene`], the camera's *true* parameters, the [`Setting`] that does not move, a
//!   [`Look`], a seed
//! - out: an 8-bit picture; the same sequence of inputs and the same seed give equal pictures
//! - source: photographs of cubes, which show colour casts, reflections, shadow edges, vignette,
//!   distortion, defocus, motion blur, mosaic and noise
//!
//! The renderer shares no constants with the detector, which would otherwise be tested against its
//! own assumptions. The background of a fixed camera is cast once. The tone curve is applied before
//! the mosaic, and noise is added to coded values, so its size is in units of the picture.

mod backdrop;
mod look;
pub mod picture;
mod raster;
mod rays;
mod sensor;
mod solids;

pub use look::{CubeLook, HandLook, Lens, Light, Look, Rgb, Sensor, Shadow};
pub use solids::Setting;

use crate::cell::{Camera, MOST_ARMS, Mount};
use crate::cube::Axis;
use crate::hw::camera::{Frame, FrameSource, NoFrame};
use crate::hw::scene::{MOST_OBJECTS, Scene, SceneArm, SceneCube};
use crate::spatial::{Pose, Twist};
use backdrop::Backdrop;
use image::RgbImage;
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
use rand::SeedableRng;
use rand_pcg::Pcg64;
use raster::{Extent, Eye, View};
use rays::Rays;
use sensor::{Converter, Photosite, Raw};
use solids::Solids;

/// Renderer of one camera.
#[derive(Debug, Clone)]
pub struct Renderer {
    camera: Camera,
    setting: Setting,
    look: Look,
    rays: Rays,
    /// Transmission of the lens per pixel, times the sensor's gain.
    gain: Vec<f32>,
    backdrop: Backdrop,
    converter: Converter,
    view: View,
    solids: Solids,
    raw: Raw,
    /// Linear colours of the scene without its moving parts.
    background: Vec<Rgb>,
    /// Reciprocal depths of the background (1/m); 0 where only the room is visible.
    behind: Vec<f32>,
    /// Coded background of a fixed camera; `None` if it has to be coded again.
    still: Option<Still>,
    /// Columns of each row in which `raw` differs from the coded background.
    dirty: Vec<(usize, usize)>,
    /// Mean of the sub-frames of a blurred frame, as the difference from the background.
    sum: Vec<Rgb>,
    rng: Pcg64,
}

/// Coded background of a fixed camera, with the pose and the exposure for which it is valid.
#[derive(Debug, Clone)]
struct Still {
    world_from_camera: Pose,
    exposure: f64,
    raw: Raw,
}

impl Renderer {
    /// Makes a renderer of a camera with its true parameters, in the default [`Setting`].
    #[must_use]
    pub fn new(camera: Camera, look: Look, seed: u64) -> Self {
        let rays = Rays::new(&camera.intrinsics);
        let pixels = rays.width * rays.height;
        // The vignette grows with the squared distance from the optical axis and reaches its full
        // value in the corner that is farthest from the axis.
        let corner = rays.x.iter().zip(&rays.y).map(|(x, y)| x * x + y * y).fold(1e-9, f32::max);
        let gain =
            rays.x.iter().zip(&rays.y).map(|(x, y)| {
                look.sensor.gain * (1.0 - look.lens.vignette * (x * x + y * y) / corner)
            });
        let setting = Setting::default();
        // "noise" in ASCII: the list of noise must not repeat the numbers that choose places in it.
        let converter = Converter::new(&look.sensor, seed ^ 0x006e_6f69_7365);
        Self {
            gain: gain.collect(),
            backdrop: Backdrop::new(&setting, &look),
            view: View::new(&rays),
            solids: Solids::default(),
            raw: Raw::new(rays.width, rays.height, converter.channels()),
            background: vec![[0.0; 3]; pixels],
            behind: vec![0.0; pixels],
            still: None,
            dirty: vec![(usize::MAX, 0); rays.height],
            sum: Vec::new(),
            rng: Pcg64::seed_from_u64(seed),
            converter,
            rays,
            camera,
            setting,
            look,
        }
    }

    /// Returns the renderer with another setting.
    #[must_use]
    pub fn with_setting(mut self, setting: Setting) -> Self {
        self.backdrop = Backdrop::new(&setting, &self.look);
        self.setting = setting;
        self.still = None;
        self
    }

    /// Returns the camera's true parameters.
    #[must_use]
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// Returns the materials, light, lens and sensor.
    #[must_use]
    pub fn look(&self) -> &Look {
        &self.look
    }

    /// Returns `world_from_camera` in a scene, or `None` if the arm that carries the camera is not
    /// in it.
    #[must_use]
    pub fn world_from_camera(&self, scene: &Scene) -> Option<Pose> {
        match self.camera.mount {
            Mount::World { world_from_camera } => Some(world_from_camera),
            Mount::Flange { arm, flange_from_camera } => {
                let arm = scene.arms[..scene.arm_count.min(scene.arms.len())].get(arm)?;
                Some(arm.world_from_flange * flange_from_camera)
            }
        }
    }

    /// Renders a picture; `exposure` scales the nominal exposure time. A camera without its arm, or
    /// with the cap on its lens, sees only its own noise.
    pub fn render(&mut self, scene: &Scene, exposure: f64) -> RgbImage {
        match self.world_from_camera(scene) {
            Some(world_from_camera) if !self.look.lens_cap => {
                self.prepare_background(&world_from_camera, exposure);
                self.draw_moving(scene, &world_from_camera, exposure);
            }
            _ => {
                // `raw` no longer holds the coded background, so the next frame codes it again.
                self.still = None;
                self.fill_raw(|_| [0.0; 3], 0.0);
            }
        }
        self.converter.develop(&self.raw, &mut self.rng)
    }

    /// Stores in each pixel of the raw picture the colour that `colour` returns for its index,
    /// scaled by `exposure`.
    fn fill_raw(&mut self, colour: impl Fn(usize) -> Rgb, exposure: f32) {
        let width = self.rays.width;
        for row in 0..self.rays.height {
            for column in 0..width {
                let pixel = row * width + column;
                let gain = self.gain[pixel] * exposure;
                self.converter.put(&mut self.raw, Photosite { row, column }, colour(pixel), gain);
            }
        }
    }

    /// Draws what does not move, for this pose and exposure, unless it is drawn already: as linear
    /// colours in `background` and, for a fixed camera, as coded values in `raw`.
    fn prepare_background(&mut self, world_from_camera: &Pose, exposure: f64) {
        if let Some(still) = &self.still
            && still.world_from_camera == *world_from_camera
            && still.exposure == exposure
        {
            // Only the columns that the last frame drew over differ from the background.
            for (row, dirty) in self.dirty.iter_mut().enumerate() {
                let (from, to) = std::mem::replace(dirty, (usize::MAX, 0));
                if from < to {
                    self.raw.restore(&still.raw, row, from..to);
                }
            }
            return;
        }
        let is_fixed = matches!(self.camera.mount, Mount::World { .. });
        // A new exposure changes the coded values, but not the colours of the cast.
        let cast = self.still.as_ref().is_some_and(|s| s.world_from_camera == *world_from_camera);
        let mut background = std::mem::take(&mut self.background);
        if !cast {
            // A hand camera moves, so it cannot keep a background. It gets a coarse room, as if out
            // of focus, and `draw_moving` adds the table.
            let grid = if is_fixed { 1 } else { 8 };
            self.cast_room(world_from_camera, grid, &mut background);
            if is_fixed {
                self.cast_furniture(world_from_camera, &mut background);
            }
        }
        // For a hand camera `draw_moving` stores every pixel of `raw` itself.
        if is_fixed {
            self.fill_raw(|pixel| background[pixel], exposure as f32);
            self.dirty.fill((usize::MAX, 0));
        }
        self.background = background;
        if is_fixed {
            let raw = self.raw.clone();
            self.still = Some(Still { world_from_camera: *world_from_camera, exposure, raw });
        }
    }

    /// Draws the room into `background`: casts a ray at every `grid`-th pixel and interpolates
    /// linearly between them.
    fn cast_room(&self, world_from_camera: &Pose, grid: usize, background: &mut [Rgb]) {
        let Rays { width, height, .. } = self.rays;
        let eye = Point3::from(world_from_camera.translation.vector);
        let at = |row: usize, column: usize| {
            let pixel = row.min(height - 1) * width + column.min(width - 1);
            let ray = Vector3::new(self.rays.x[pixel].into(), self.rays.y[pixel].into(), 1.0);
            self.backdrop.colour(&eye, &(world_from_camera.rotation * ray))
        };
        if grid == 1 {
            for (pixel, colour) in background.iter_mut().enumerate() {
                *colour = at(pixel / width, pixel % width);
            }
            return;
        }
        // One more point than cells, so that the last cell has a right neighbour; `at` clamps it to
        // the picture. Each line of points is cast once: `below` becomes the next `above`.
        let columns = width.div_ceil(grid) + 1;
        let line = |row: usize| -> Vec<Rgb> { (0..columns).map(|k| at(row, k * grid)).collect() };
        let mut above = line(0);
        for top in (0..height).step_by(grid) {
            let below = line(top + grid);
            for row in top..(top + grid).min(height) {
                let down = (row - top) as f32 / grid as f32;
                let mix = |a: Rgb, b: Rgb, s: f32| -> Rgb {
                    std::array::from_fn(|c| a[c] + s * (b[c] - a[c]))
                };
                let out = &mut background[row * width..(row + 1) * width];
                for (k, out) in out.chunks_mut(grid).enumerate() {
                    let left = mix(above[k], below[k], down);
                    let right = mix(above[k + 1], below[k + 1], down);
                    for (i, colour) in out.iter_mut().enumerate() {
                        *colour = mix(left, right, i as f32 / grid as f32);
                    }
                }
            }
            above = below;
        }
    }

    /// Draws table and tray over the room in `background`, and records their depths in `behind`.
    fn cast_furniture(&mut self, world_from_camera: &Pose, background: &mut [Rgb]) {
        self.solids.clear();
        self.solids.add_furniture(&self.setting);
        let camera_from_world = &world_from_camera.inverse();
        let eye = Eye { rays: &self.rays, camera_from_world, look: &self.look };
        self.view.look_at(eye, &self.solids, Extent::Before(None));
        // A copy, because edges mix the table with the room while the table overwrites it.
        let room = background.to_vec();
        self.behind.fill(0.0);
        for row in 0..self.rays.height {
            let line = row * self.rays.width;
            let (from, to) = self.view.span(row);
            if from < to {
                // Outside its spans the view's depths are left over from earlier casts.
                let range = line + from..line + to;
                self.behind[range.clone()].copy_from_slice(&self.view.depth()[range]);
            }
            self.view.colour_row(&self.rays, row, &room, |column, colours| {
                background[line + column..][..colours.len()].copy_from_slice(colours);
            });
        }
    }

    /// Draws the moving parts of a scene over the background, with their motion blur.
    fn draw_moving(&mut self, scene: &Scene, world_from_camera: &Pose, exposure: f64) {
        let camera_from_world = &world_from_camera.inverse();
        let exposure = exposure as f32;
        let is_fixed = self.gather(scene);
        // A fixed camera has drawn its furniture already, and the depths of the background decide
        // what it hides. A hand camera draws all solids in front of the room.
        let behind = is_fixed.then_some(self.behind.as_slice());
        let extent = if is_fixed { Extent::Before(behind) } else { Extent::All };
        let eye = Eye { rays: &self.rays, camera_from_world, look: &self.look };
        self.view.look_at(eye, &self.solids, extent);
        let (converter, raw, gain) = (&self.converter, &mut self.raw, &self.gain);
        for row in 0..self.rays.height {
            let line = row * self.rays.width;
            self.dirty[row] = self.view.span(row);
            self.view.colour_row(&self.rays, row, &self.background, |column, colours| {
                let site = Photosite { row, column };
                converter.put_run(raw, site, colours, (&gain[line + column..], exposure));
            });
        }
        self.blur_motion(scene, camera_from_world, exposure);
    }

    /// Collects the solids that a frame draws over the background. Returns whether the camera is
    /// fixed: then the furniture is not among them, since it is part of the background.
    fn gather(&mut self, scene: &Scene) -> bool {
        self.solids.clear();
        match self.camera.mount {
            Mount::World { .. } => {
                self.solids.add_moving(scene, &self.setting, &self.look, None);
                true
            }
            Mount::Flange { arm, .. } => {
                self.solids.add_moving(scene, &self.setting, &self.look, Some(arm));
                self.solids.add_furniture(&self.setting);
                false
            }
        }
    }

    /// Redraws the part of the picture in which something moves, as the mean of several sub-frames
    /// spread over the exposure.
    fn blur_motion(&mut self, scene: &Scene, camera_from_world: &Pose, exposure: f32) {
        let time = self.look.sensor.exposure_time * f64::from(exposure);
        let count = self.sub_frames(scene, camera_from_world, time);
        if count < 2 {
            return;
        }
        // Each sub-frame shows the middle of its part of the exposure. The scene is the middle of
        // the whole exposure, so the offsets sum to zero.
        let offset = |k: usize| ((k as f64 + 0.5) / count as f64 - 0.5) * time;
        // The windows of the first and the last place contain those between, up to their margins,
        // because the motion within one exposure is nearly straight.
        self.gather(&displaced(scene, offset(0)));
        let first = self.solids.clone();
        let is_fixed = self.gather(&displaced(scene, offset(count - 1)));
        let eye = Eye { rays: &self.rays, camera_from_world, look: &self.look };
        let Some(region) = self.view.changed(eye, &first, &self.solids) else { return };
        let (columns, rows) = region.inner(&self.rays).ranges();
        let width = self.rays.width;
        let size = columns.len() * rows.len();
        self.sum.clear();
        self.sum.resize(size, [0.0; 3]);
        let share = 1.0 / count as f32;
        for k in 0..count {
            self.gather(&displaced(scene, offset(k)));
            let behind = is_fixed.then_some(self.behind.as_slice());
            let extent = Extent::Inside(region, behind);
            let eye = Eye { rays: &self.rays, camera_from_world, look: &self.look };
            self.view.look_at(eye, &self.solids, extent);
            for (line, row) in rows.clone().enumerate() {
                let sum = &mut self.sum[line * columns.len()..(line + 1) * columns.len()];
                let background = &self.background;
                self.view.colour_row(&self.rays, row, background, |column, colours| {
                    // `colour_row` passes over pixels of the background. As a difference from the
                    // background they count without a visit.
                    let behind = &background[row * width + column..];
                    let sums = &mut sum[column - columns.start..];
                    for (sum, (colour, behind)) in sums.iter_mut().zip(colours.iter().zip(behind)) {
                        for c in 0..3 {
                            sum[c] += share * (colour[c] - behind[c]);
                        }
                    }
                });
            }
        }
        for (line, row) in rows.enumerate() {
            let (from, to) = self.dirty[row];
            self.dirty[row] = (from.min(columns.start), to.max(columns.end));
            for (k, column) in columns.clone().enumerate() {
                let pixel = row * width + column;
                let (sum, behind) = (self.sum[line * columns.len() + k], self.background[pixel]);
                // Rounding can leave a dark pixel slightly below zero.
                let colour = std::array::from_fn(|c| (behind[c] + sum[c]).max(0.0));
                let (site, gain) = (Photosite { row, column }, self.gain[pixel] * exposure);
                self.converter.put(&mut self.raw, site, colour, gain);
            }
        }
    }

    /// Returns the number of sub-frames for an exposure of `time` (s), so that the cube moves by
    /// about a pixel in each; 1 if its motion is not visible.
    fn sub_frames(&self, scene: &Scene, camera_from_world: &Pose, time: f64) -> usize {
        let cube = &scene.cube;
        let centre = camera_from_world * Point3::from(cube.world_from_cube.translation.vector);
        // The estimate below divides by the depth, which is useless within 5 cm of the camera and
        // wrong behind it.
        if centre.z < 0.05 {
            return 1;
        }
        // A corner is 0.87 edges from the centre; a little less is enough for this estimate.
        let speed = cube.velocity.linear.norm() + cube.velocity.angular.norm() * cube.edge * 0.8;
        let pixels = speed * time * self.camera.intrinsics.focal.0 / centre.z;
        // Half a pixel is not visible beside the defocus; 8 bounds the time that a frame takes.
        if pixels < 0.5 { 1 } else { (pixels.ceil() as usize).clamp(2, 8) }
    }
}

/// Returns the scene `dt` (s) later: the cube moves, together with the hand and the grippers that
/// hold it.
fn displaced(scene: &Scene, dt: f64) -> Scene {
    let cube = &scene.cube;
    let centre = cube.world_from_cube.translation.vector;
    let turn = UnitQuaternion::from_scaled_axis(cube.velocity.angular * dt);
    let shift = cube.velocity.linear * dt;
    let motion = Pose::from_parts(Translation3::from(centre + shift - turn * centre), turn);
    // A hand or a tool that holds the cube has its origin at most half an edge (28.5 mm) from the
    // cube's centre.
    let near = |pose: &Pose| (pose.translation.vector - centre).norm() < 0.04;
    let mut moved = *scene;
    moved.cube.world_from_cube = motion * cube.world_from_cube;
    if let Some(hand) = moved.hand.as_mut().filter(|hand| near(hand)) {
        *hand = motion * *hand;
    }
    for arm in &mut moved.arms {
        if near(&arm.world_from_tool) {
            arm.world_from_tool = motion * arm.world_from_tool;
        }
    }
    moved
}

/// Makes a scene with a cube at rest, without arms and hand.
#[must_use]
pub fn cube_alone(world_from_cube: Pose, edge: f64, facelets: [u8; 54]) -> Scene {
    let arm = SceneArm {
        points: [Point3::origin(); 5],
        world_from_tool: Pose::identity(),
        world_from_flange: Pose::identity(),
        opening: 0.0,
    };
    let velocity = Twist::default();
    let turned = (Axis::Z, 0.0, 0.0);
    let cube = SceneCube { world_from_cube, velocity, edge, facelets, turned };
    let objects = [None; MOST_OBJECTS];
    Scene { period: 0, cube, arms: [arm; MOST_ARMS], arm_count: 0, hand: None, objects }
}

/// Camera of the plant, which renders the latest scene that the plant has published.
pub struct PlantCamera {
    renderer: Renderer,
    scene: triple_buffer::Output<Scene>,
}

impl PlantCamera {
    /// Makes a camera that renders the scenes which the plant publishes.
    #[must_use]
    pub fn new(renderer: Renderer, scene: triple_buffer::Output<Scene>) -> Self {
        Self { renderer, scene }
    }
}

impl FrameSource for PlantCamera {
    /// Renders the latest scene. The frame carries the period of that scene, which is the requested
    /// one if plant and camera run in step.
    fn grab(&mut self, _period: u64, exposure: f64) -> Result<Frame, NoFrame> {
        let scene = *self.scene.read();
        let camera = &self.renderer.camera.name;
        let refuse = |reason: &str| NoFrame { camera: camera.clone(), reason: reason.to_owned() };
        if !(exposure.is_finite() && exposure > 0.0) {
            return Err(refuse(&format!("exposure {exposure} is not a positive number")));
        }
        // `render` would return a dark frame, which a caller could take for a dark cell.
        if self.renderer.world_from_camera(&scene).is_none() {
            return Err(refuse("the scene lacks the arm that carries the camera"));
        }
        Ok(Frame { period: scene.period, image: self.renderer.render(&scene, exposure) })
    }
}

#[cfg(test)]
mod tests;
