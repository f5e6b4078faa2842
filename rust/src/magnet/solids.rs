//! Uniformly magnetized bodies without axial symmetry about their moment: cylinders and rings
//! magnetized across their axis, blocks and balls.
//!
//! A body of remanence `B_r` has `H = ∇∇N · m̂` with `N = B_r/4π ∫ dV/|r − r′|`, and
//! `B = μ₀H + B_r m̂` inside it (Jackson 1999, sec. 5.9). One N serves every direction of `m̂`.

use super::axial::{Potential, Shell};
use super::sources::{MAGNETIC_CONSTANT, dipole};
use glam::{DMat3, DVec3};
use std::f64::consts::PI;

/// Distance of an edge at which a point is on it, relative to the block's size.
const TOUCH: f64 = 1e-9;
/// Distance from which a block is a set of dipoles, as a multiple of half its diagonal.
const FAR: f64 = 10.0;
/// Points and weights of Gaussian quadrature with four points on −1 to 1.
const GAUSS: [(f64, f64); 4] = [
    (-0.861_136_311_594_052_6, 0.347_854_845_137_453_85),
    (-0.339_981_043_584_856_3, 0.652_145_154_862_546_2),
    (0.339_981_043_584_856_3, 0.652_145_154_862_546_2),
    (0.861_136_311_594_052_6, 0.347_854_845_137_453_85),
];

fn symmetric(xx: f64, yy: f64, zz: f64, xy: f64, xz: f64, yz: f64) -> DMat3 {
    DMat3::from_cols_array(&[xx, xy, xz, xy, yy, yz, xz, yz, zz])
}

/// Field of a cylinder magnetized across its axis, which is the x axis; its moment is along z.
///
/// With `G = N_ρ/ρ` and the axial field of the same cylinder, div B = 0 gives
/// `ρ²h = −B_z − 2G = ρ ∂G/∂ρ` and `ρ²k = −4h − ∂_z(B_ρ/ρ) = ρ ∂h/∂ρ`; near the axis
/// `h = −∂_z(B_ρ/ρ)/4`.
pub fn across(shell: &Shell, p: DVec3) -> (DVec3, DMat3) {
    let (x, y, z) = (p.z, -p.y, p.x); // the cylinder's own frame, magnetized along its x
    let rho2 = x * x + y * y;
    let Potential { axial, radial, is_near_axis, inside } = shell.potential(rho2.sqrt(), z);
    let over = if is_near_axis { 0.0 } else { 1.0 / rho2 };
    let (h, k, g) = if is_near_axis {
        let h = -0.25 * axial.radial_slope;
        (h, 0.0, -0.5 * (axial.along + rho2 * h))
    } else {
        let h = -(axial.along + 2.0 * radial) * over;
        (h, -(4.0 * h + axial.radial_slope) * over, radial)
    };
    let bend = if is_near_axis { 0.0 } else { -(2.0 * axial.radial + axial.along_slope) * over };
    let flux = DVec3::new(g + x * x * h + inside, x * y * h, x * axial.radial);
    let gradient = symmetric(
        x * (3.0 * h + x * x * k),
        x * (h + y * y * k),
        x * axial.radial_slope,
        y * (h + x * x * k),
        axial.radial + x * x * bend,
        x * y * bend,
    );
    let turn = DMat3::from_cols(DVec3::Z, -DVec3::Y, DVec3::X);
    (turn * flux, turn * gradient * turn.transpose())
}

/// Field of a ball of remanence `remanence` [T], magnetized along z (Jackson 1999, eq. 5.105).
pub fn ball(radius: f64, remanence: f64, p: DVec3) -> (DVec3, DMat3) {
    if p.length_squared() < radius * radius {
        return (2.0 / 3.0 * remanence * DVec3::Z, DMat3::ZERO);
    }
    let moment = 4.0 / 3.0 * PI * radius.powi(3) * remanence / MAGNETIC_CONSTANT;
    let (flux, gradient, _) = dipole(moment, p);
    (flux, gradient)
}

/// Field of a block with half edges `half` [m], magnetized along z.
///
/// The field of two charged rectangles (Yang et al., Supercond. Sci. Technol. 3:591, 1990), and its
/// derivatives. On a face it is the mean of both sides.
pub fn block(half: DVec3, remanence: f64, p: DVec3) -> (DVec3, DMat3) {
    if p.length_squared() > FAR * FAR * half.length_squared() {
        return distant_block(half, remanence, p);
    }
    let (mut flux, mut gradient) = (DVec3::ZERO, [0.0; 5]);
    for corner in 0..8 {
        let sign = |axis: usize| if corner >> axis & 1 == 0 { 1.0 } else { -1.0 };
        let s = DVec3::new(sign(0), sign(1), sign(2));
        let d = p - s * half;
        let (r, s) = (d.length(), s.x * s.y * s.z);
        let (xz2, yz2) = (d.x * d.x + d.z * d.z, d.y * d.y + d.z * d.z);
        let bend = if d.z == 0.0 { 0.0 } else { (d.x * d.y / (d.z * r)).atan() };
        flux += s * DVec3::new(-(d.y / xz2.sqrt()).asinh(), -(d.x / yz2.sqrt()).asinh(), bend);
        let (over_xz, over_yz) = (s / (xz2 * r), s / (yz2 * r));
        let terms = [
            d.x * d.y * over_xz,
            d.x * d.y * over_yz,
            -s / r,
            d.z * d.y * over_xz,
            d.z * d.x * over_yz,
        ];
        gradient.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
    }
    let scale = remanence / (4.0 * PI);
    let [xx, yy, xy, xz, yz] = gradient.map(|sum| scale * sum);
    let inside = |d: f64, half: f64| -> f64 {
        match half - d.abs() {
            depth if depth > 0.0 => 1.0,
            0.0 => 0.5,
            _ => 0.0,
        }
    };
    let share = inside(p.x, half.x).min(inside(p.y, half.y)).min(inside(p.z, half.z));
    (scale * flux + share * remanence * DVec3::Z, symmetric(xx, yy, -xx - yy, xy, xz, yz))
}

/// Field of a distant block, where the closed form cancels: Gaussian quadrature over dipoles.
fn distant_block(half: DVec3, remanence: f64, p: DVec3) -> (DVec3, DMat3) {
    let moment = half.x * half.y * half.z * remanence / MAGNETIC_CONSTANT;
    let (mut flux, mut gradient) = (DVec3::ZERO, DMat3::ZERO);
    for (x, wx) in GAUSS {
        for (y, wy) in GAUSS {
            for (z, wz) in GAUSS {
                let part = dipole(moment * wx * wy * wz, p - half * DVec3::new(x, y, z));
                flux += part.0;
                gradient += part.1;
            }
        }
    }
    (flux, gradient)
}

/// True if a point is on an edge of a block, where the field has no limit.
pub fn is_on_edge(half: DVec3, p: DVec3) -> bool {
    let away = p.abs() - half;
    let limit = TOUCH * half.max_element();
    let touches = |u: f64, v: f64, w: f64| u.hypot(v) < limit && w < limit;
    touches(away.x, away.y, away.z)
        || touches(away.x, away.z, away.y)
        || touches(away.y, away.z, away.x)
}
