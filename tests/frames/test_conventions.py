"""Quaternions and velocities of other packages, as the page on conventions says."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cg.frames import SE3, UnitQuaternion

RANDOM = np.random.default_rng(53)
TURN = Rotation.random(rng=RANDOM)
Q, OMEGA, SPEED = TURN.as_quat(canonical=True), RANDOM.normal(size=3), RANDOM.normal(size=3)
MOVED = UnitQuaternion().flow(OMEGA, Q)  # by an angular velocity in body axes
close = np.testing.assert_allclose


def wxyz(q):
    return np.roll(q, 1)


def test_mujoco():
    mujoco = pytest.importorskip("mujoco")
    body = '<body><freejoint/><geom size="1"/></body>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    data = mujoco.MjData(model)
    data.qpos[:] = qpos = np.array([1.0, 2.0, 3.0, *wxyz(Q)])
    mujoco.mj_kinematics(model, data)
    close(data.xmat[1].reshape(3, 3), TURN.as_matrix(), atol=1e-15)
    mujoco.mj_integratePos(model, qpos, np.append(SPEED, OMEGA), 1.0)
    close(qpos, [*(np.array([1.0, 2.0, 3.0]) + SPEED), *wxyz(MOVED)], atol=1e-15)


def test_pinocchio():
    pin = pytest.importorskip("pinocchio")
    model = pin.Model()
    model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    moved = pin.integrate(model, np.append(np.zeros(3), Q), np.append(SPEED, OMEGA))
    pose = SE3().flow(
        np.append(OMEGA, SPEED), np.block([[TURN.as_matrix(), np.zeros((3, 1))], [np.eye(4)[3]]])
    )
    close(moved[:3], pose[:3, 3], atol=1e-15)
    close(Rotation.from_quat(moved[3:]).as_matrix(), pose[:3, :3], atol=1e-15)


def test_spatialmath():
    spatialmath = pytest.importorskip("spatialmath")
    q = spatialmath.UnitQuaternion(wxyz(Q))
    close(q.R, TURN.as_matrix(), atol=1e-15)
    close(q.dotb(OMEGA), wxyz(UnitQuaternion().field(OMEGA, Q)), atol=1e-15)
    close(q.dot(OMEGA), wxyz(UnitQuaternion("space").field(OMEGA, Q)), atol=1e-15)
    pose = spatialmath.Twist3(np.append(SPEED, OMEGA)).SE3().A
    close(pose, SE3().flow(np.append(OMEGA, SPEED), np.eye(4)), atol=1e-14)


def test_basilisk():
    kinematics = pytest.importorskip("Basilisk.utilities.RigidBodyKinematics")
    sigma = TURN.as_mrp()
    close(kinematics.MRP2C(sigma), TURN.as_matrix().T, atol=1e-15)
    close(kinematics.MRP2EP(sigma), wxyz(Q), atol=1e-15)
    close(kinematics.dEP(wxyz(Q), OMEGA), wxyz(UnitQuaternion().field(OMEGA, Q)), atol=1e-15)
