"""Rotations: Hamilton quaternions wxyz, rotation vectors in radians, matrices.  All functions batch over leading axes.

Conventions: `R(q) v` maps body to world for `q_w_b`; `retract(q, d) = q * Exp(d)` perturbs on the body side.
"""

import numpy as np


def multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Hamilton product a * b, (..., 4)."""
    a, b = np.asarray(a), np.asarray(b)
    aw, ax, ay, az = a[..., 0], a[..., 1], a[..., 2], a[..., 3]
    bw, bx, by, bz = b[..., 0], b[..., 1], b[..., 2], b[..., 3]
    w = aw * bw - ax * bx - ay * by - az * bz
    out = np.empty((*w.shape, 4))
    out[..., 0] = w
    out[..., 1] = aw * bx + ax * bw + ay * bz - az * by
    out[..., 2] = aw * by - ax * bz + ay * bw + az * bx
    out[..., 3] = aw * bz + ax * by - ay * bx + az * bw
    return out


def left_matrix(q: np.ndarray) -> np.ndarray:
    """(..., 4) -> (..., 4, 4) with left_matrix(q) p = q * p."""
    return np.moveaxis(multiply(np.asarray(q)[..., None, :], np.eye(4)), -2, -1)


def right_matrix(q: np.ndarray) -> np.ndarray:
    """(..., 4) -> (..., 4, 4) with right_matrix(q) p = p * q."""
    return np.moveaxis(multiply(np.eye(4), np.asarray(q)[..., None, :]), -2, -1)


def inverse(q: np.ndarray) -> np.ndarray:
    """Conjugate of a unit quaternion."""
    return np.asarray(q) * np.array([1.0, -1.0, -1.0, -1.0])


def normalize(q: np.ndarray) -> np.ndarray:
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def rotate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """R(q) v for (..., 4) and (..., 3)."""
    q = np.asarray(q)
    u, w = q[..., 1:], q[..., :1]
    t = 2.0 * _cross(u, v)
    return v + w * t + _cross(u, t)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """np.cross of (..., 3), the same to the bit and ten times as fast for a single one."""
    b = np.asarray(b)
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    x = ay * bz - az * by
    out = np.empty((*x.shape, 3))
    out[..., 0], out[..., 1], out[..., 2] = x, az * bx - ax * bz, ax * by - ay * bx
    return out


def to_matrix(q: np.ndarray) -> np.ndarray:
    """(..., 4) -> (..., 3, 3)."""
    q = np.asarray(q, float)
    w, x, y, z = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    R = np.empty((*w.shape, 3, 3))
    R[..., 0, 0], R[..., 0, 1], R[..., 0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    R[..., 1, 0], R[..., 1, 1], R[..., 1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    R[..., 2, 0], R[..., 2, 1], R[..., 2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    return R


def from_matrix(R: np.ndarray) -> np.ndarray:
    """(..., 3, 3) -> (..., 4) with w >= 0; the largest component decides the branch (Shepperd)."""
    R = np.asarray(R, float)
    m00, m11, m22 = R[..., 0, 0], R[..., 1, 1], R[..., 2, 2]
    diagonal = np.stack([m00 + m11 + m22, m00, m11, m22], -1)
    w = np.stack(
        [1 + diagonal[..., 0], R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]],
        -1,
    )
    x = np.stack([w[..., 1], 1 + m00 - m11 - m22, R[..., 0, 1] + R[..., 1, 0], R[..., 0, 2] + R[..., 2, 0]], -1)
    y = np.stack([w[..., 2], x[..., 2], 1 - m00 + m11 - m22, R[..., 1, 2] + R[..., 2, 1]], -1)
    z = np.stack([w[..., 3], x[..., 3], y[..., 3], 1 - m00 - m11 + m22], -1)
    branches = np.stack([w, x, y, z], -2)
    best = np.argmax(diagonal, -1)[..., None, None]
    q = np.take_along_axis(branches, best, -2)[..., 0, :]
    q = normalize(q)
    return np.where(q[..., :1] < 0, -q, q)


def exp(d: np.ndarray) -> np.ndarray:
    """Rotation vector (..., 3) -> quaternion."""
    d = np.asarray(d, float)
    angle = np.linalg.norm(d, axis=-1, keepdims=True)
    half = 0.5 * angle
    return np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * d], -1)


def log(q: np.ndarray) -> np.ndarray:
    """Quaternion -> rotation vector (..., 3), the short way round."""
    q = np.where(q[..., :1] < 0, -q, q)
    norm = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(norm, q[..., :1])
    scale = np.where(norm > 1e-12, angle / np.maximum(norm, 1e-300), 2.0 / np.maximum(q[..., :1], 1e-300))
    return scale * q[..., 1:]


def retract(q: np.ndarray, d: np.ndarray) -> np.ndarray:
    """q * Exp(d), normalised."""
    return normalize(multiply(q, exp(d)))


def difference(q: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """d with q = reference * Exp(d)."""
    return log(multiply(inverse(reference), q))


def skew(v: np.ndarray) -> np.ndarray:
    """(..., 3) -> (..., 3, 3) with skew(a) b = a x b."""
    v = np.asarray(v, float)
    K = np.zeros((*v.shape, 3))
    K[..., 0, 1], K[..., 0, 2], K[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    K[..., 1, 0], K[..., 2, 0], K[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return K


def right_jacobian(d: np.ndarray) -> np.ndarray:
    """J_r with Exp(d + e) = Exp(d) Exp(J_r e) to first order, (..., 3) -> (..., 3, 3)."""
    K = skew(d)
    angle2 = np.sum(np.square(d), -1)[..., None, None]
    small = angle2 < 1e-6
    safe = np.where(small, 1.0, angle2)
    angle = np.sqrt(safe)
    a = np.where(small, 0.5 - angle2 / 24.0, (1.0 - np.cos(angle)) / safe)
    b = np.where(small, 1.0 / 6.0 - angle2 / 120.0, (angle - np.sin(angle)) / (safe * angle))
    return np.eye(3) - a * K + b * (K @ K)


def from_two_vectors(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The smallest rotation that turns direction a (3,) into direction b (3,)."""
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    w = 1.0 + a @ b
    if w < 1e-12:
        axis = np.cross(a, [1.0, 0.0, 0.0] if abs(a[0]) < 0.9 else [0.0, 1.0, 0.0])
        return np.concatenate([[0.0], axis / np.linalg.norm(axis)])
    return normalize(np.concatenate([[w], np.cross(a, b)]))


def heading(q_w_b: np.ndarray) -> np.ndarray:
    """Yaw in radians by ZYX Euler angles.  Meaningless near pitch +-90 degrees (REFERENCE 23.1)."""
    R = to_matrix(q_w_b)
    return np.arctan2(R[..., 1, 0], R[..., 0, 0])
