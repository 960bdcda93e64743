"""Rotations in float64, for kernels."""

import warp as wp


@wp.func
def wide(v: wp.vec3) -> wp.vec3d:
    """A vector in float64."""
    return wp.vec3d(wp.float64(v[0]), wp.float64(v[1]), wp.float64(v[2]))


@wp.func
def wide_matrix(m: wp.mat33) -> wp.mat33d:
    """A matrix in float64."""
    result = wp.mat33d()
    for i in range(3):
        for j in range(3):
            result[i, j] = wp.float64(m[i, j])
    return result


@wp.func
def rotation_from_vector(v: wp.vec3d) -> wp.mat33d:
    """Rotation matrix of a rotation vector [rad], rounded to float32 as in robosuite.

    See `manip.sim.control_laws.rotation_from_vector`.
    """
    angle = wp.length(v)
    length = angle
    if angle <= wp.float64(0.0):
        length = wp.float64(1.0)
    half = wp.sin(angle / wp.float64(2.0))
    a = wp.float32(wp.cos(angle / wp.float64(2.0)))
    b = wp.float32(v[0] / length * half)
    c = wp.float32(v[1] / length * half)
    d = wp.float32(v[2] / length * half)
    root = wp.sqrt(wp.float64(2.0) / wp.float64(a * a + b * b + c * c + d * d))
    a = wp.float32(wp.float64(a) * root)
    b = wp.float32(wp.float64(b) * root)
    c = wp.float32(wp.float64(c) * root)
    d = wp.float32(wp.float64(d) * root)
    return matrix_of(a, b, c, d)


@wp.func
def matrix_of(a: wp.float32, b: wp.float32, c: wp.float32, d: wp.float32) -> wp.mat33d:
    """Rotation matrix of the quaternion (a, b, c, d) / sqrt(2), products in float32."""
    one = wp.float64(1.0)
    return wp.mat33d(
        one - wp.float64(c * c) - wp.float64(d * d), wp.float64(b * c - d * a),
        wp.float64(b * d + c * a),
        wp.float64(b * c + d * a), one - wp.float64(b * b) - wp.float64(d * d),
        wp.float64(c * d - b * a),
        wp.float64(b * d - c * a), wp.float64(c * d + b * a),
        one - wp.float64(b * b) - wp.float64(c * c),
    )  # fmt: skip
