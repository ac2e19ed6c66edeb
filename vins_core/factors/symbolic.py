"""Rotations and poses in CasADi SX: the vocabulary in which residuals are written.

Quaternions are Hamilton wxyz.  A `Pose` may carry a tangent perturbation d = (dp, dtheta) at zero,

    p [+] dp = p + dp,        q [+] dtheta = q * Exp(dtheta),

so that a residual is differentiated with respect to d by AD *through* the retraction.  `rotate` uses
R Exp(d) v = R (v + d x v) + O(d^2), exact to first order, which makes the derivative as cheap as a hand-written
Jacobian: no derivative of quaternion products or of matrix entries ever appears.
"""

from __future__ import annotations

import casadi as ca


def multiply(a: ca.SX, b: ca.SX) -> ca.SX:
    """Hamilton product a * b."""
    aw, ax, ay, az = ca.vertsplit(a)
    bw, bx, by, bz = ca.vertsplit(b)
    return ca.vertcat(
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def conjugate(q: ca.SX) -> ca.SX:
    return ca.vertcat(q[0], -q[1:])


def rotation_matrix(q: ca.SX) -> ca.SX:
    """R(q) of a unit quaternion, (3, 3)."""
    w, x, y, z = ca.vertsplit(q)
    x2, y2, z2 = x + x, y + y, z + z
    return ca.vertcat(
        ca.horzcat(1 - (y * y2 + z * z2), x * y2 - w * z2, x * z2 + w * y2),
        ca.horzcat(x * y2 + w * z2, 1 - (x * x2 + z * z2), y * z2 - w * x2),
        ca.horzcat(x * z2 - w * y2, y * z2 + w * x2, 1 - (x * x2 + y * y2)),
    )


def small_rotation(theta: ca.SX) -> ca.SX:
    """Unit quaternion of a small rotation vector, (1, theta / 2) normalised: Exp(theta) to second order."""
    return ca.vertcat(1, theta / 2) / ca.sqrt(1 + ca.dot(theta, theta) / 4)


class Pose:
    """A rigid transform as a residual sees it, `T_a_b` from x = (p, q wxyz), optionally moved by d (6,).

    `act` and `inverse_act` take homogeneous points (v, s), the point v / s: a landmark at inverse depth s stays
    finite, and its residual smooth, when s crosses zero.
    """

    def __init__(self, x: ca.SX, d: ca.SX | None = None):
        self.R = rotation_matrix(x[3:])
        self.p, self.q, self._dtheta = x[:3], x[3:], None
        if d is not None:
            self.p = self.p + d[:3]
            self.q = multiply(self.q, ca.vertcat(1, d[3:] / 2))
            self._dtheta = d[3:]

    def rotate(self, v: ca.SX) -> ca.SX:
        """R v."""
        return self.R @ (v if self._dtheta is None else v + ca.cross(self._dtheta, v))

    def inverse_rotate(self, v: ca.SX) -> ca.SX:
        """R' v."""
        u = self.R.T @ v
        return u if self._dtheta is None else u - ca.cross(self._dtheta, u)

    def act(self, v: ca.SX, s: ca.SX | float = 1) -> ca.SX:
        """R v + s p: the homogeneous point (v, s) of frame b in frame a."""
        return self.rotate(v) + s * self.p

    def inverse_act(self, v: ca.SX, s: ca.SX | float = 1) -> ca.SX:
        """R' (v - s p): the homogeneous point (v, s) of frame a in frame b."""
        return self.inverse_rotate(v - s * self.p)
