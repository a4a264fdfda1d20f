//! Quads as two triangles each, and back.

/// The triangles of a quad, which meet along the diagonal from its second to its last corner.
pub(super) fn halves([a, b, c, d]: [u32; 4]) -> [[u32; 3]; 2] {
    [[a, b, d], [c, d, b]]
}

/// Face of a primitive, of which the first `triangles` are faces themselves; and whether it is the second half of a quad.
#[inline(always)]
pub(super) fn face_of(primitive: u32, triangles: u32) -> (u32, bool) {
    let beyond = primitive.saturating_sub(triangles);
    (primitive.min(triangles) + (beyond >> 1), beyond & 1 != 0)
}

/// A coordinate on a half, from the first corner of its quad.
#[inline(always)]
pub(super) fn turned(x: f32, second: bool) -> f32 {
    if second { 1.0 - x } else { x }
}
