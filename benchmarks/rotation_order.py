"""Measure at which order simulators of rigid bodies move a rotation.

``python -m benchmarks.rotation_order`` measures each simulator that can be imported, and stores the
results in ``rotation_order.json``, where results of other versions stay. ``make implementations``
writes them to the page. A free body tumbles for two seconds without forces; the error is the angle
between its attitude and the reference solution of `cg.problems.FreeRigidBody`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import cg
from cg.analysis.convergence import observed_order

DATA = Path(__file__).with_name("rotation_order.json")
INERTIA = (1.0, 2.0, 2.5)  # principal moments (kg m^2)
RATE = (1.0, 2.0, -0.5)  # angular velocity in body axes at time zero (rad/s)
END = 2.0  # s
STEPS = (50, 100, 200, 400, 800)
FLOOR = 1e-11  # smaller errors are close to rounding

Turn = Callable[[int], Rotation]
"""Returns the attitude at the end after a number of steps."""


def mujoco() -> Iterator[tuple[str, Turn]]:
    """Yield the integrators of MuJoCo, for a free joint."""
    import mujoco as mj

    def turn(integrator: str, steps: int) -> Rotation:
        moments = " ".join(map(str, INERTIA))
        model = mj.MjModel.from_xml_string(
            f'<mujoco><option gravity="0 0 0" integrator="{integrator}" timestep="{END / steps}"/>'
            '<worldbody><body><freejoint/><inertial pos="0 0 0" mass="1" '
            f'diaginertia="{moments}"/></body></worldbody></mujoco>'
        )
        data = mj.MjData(model)
        data.qvel[3:] = RATE
        for _ in range(steps):
            mj.mj_step(model, data)
        return Rotation.from_quat(data.qpos[3:], scalar_first=True)

    for name in ("RK4", "Euler", "implicit", "implicitfast"):
        yield name, partial(turn, name)


def pin() -> Iterator[tuple[str, Turn]]:
    """Yield the loop of Pinocchio's examples, which has no integrator of its own."""
    import pinocchio

    model = spherical_model()

    def turn(steps: int) -> Rotation:
        data, q, v = model.createData(), pinocchio.neutral(model), np.array(RATE)
        for _ in range(steps):
            v += END / steps * pinocchio.aba(model, data, q, v, np.zeros(3))
            q = pinocchio.integrate(model, q, END / steps * v)
        return Rotation.from_quat(q)

    yield "semi-implicit Euler, written with `integrate`", turn


def spherical_model() -> Any:
    """Return Pinocchio's model of a body that turns about its centre of mass."""
    import pinocchio

    model = pinocchio.Model()
    model.gravity.linear = np.zeros(3)
    joint = model.addJoint(0, pinocchio.JointModelSpherical(), pinocchio.SE3.Identity(), "body")
    inertia = pinocchio.Inertia(1.0, np.zeros(3), np.diag(INERTIA))
    model.appendBodyToJoint(joint, inertia, pinocchio.SE3.Identity())
    return model


def crocoddyl() -> Iterator[tuple[str, Turn]]:
    """Yield the integrated action models of Crocoddyl."""
    import crocoddyl as croc

    state = croc.StateMultibody(spherical_model())
    actuation = croc.ActuationModelFull(state)
    costs = croc.CostModelSum(state, actuation.nu)
    body = croc.DifferentialActionModelFreeFwdDynamics(state, actuation, costs)
    integrators = {"IntegratedActionModelEuler": partial(croc.IntegratedActionModelEuler, body)}
    for order in ("two", "three", "four"):
        kind = getattr(croc.RKType, order)
        integrators[f"IntegratedActionModelRK, {order}"] = partial(
            croc.IntegratedActionModelRK, body, kind
        )

    def turn(make: Callable[[float], Any], steps: int) -> Rotation:
        model = make(END / steps)
        data, x = model.createData(), np.concatenate([[0.0, 0.0, 0.0, 1.0], RATE])
        for _ in range(steps):
            model.calc(data, x, np.zeros(3))
            x = data.xnext.copy()
        return Rotation.from_quat(x[:4])

    for name, make in integrators.items():
        yield name, partial(turn, make)


def drake() -> Iterator[tuple[str, Turn]]:
    """Yield the integrators of Drake for a continuous plant, and its discrete plant."""
    from pydrake.math import RotationMatrix
    from pydrake.multibody.plant import MultibodyPlant
    from pydrake.multibody.tree import SpatialInertia, UnitInertia
    from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator

    def turn(scheme: str, steps: int) -> Rotation:
        plant = MultibodyPlant(time_step=0.0 if scheme else END / steps)
        plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
        inertia = SpatialInertia(1.0, np.zeros(3), UnitInertia(*INERTIA))
        body = plant.AddRigidBody("body", inertia)
        plant.Finalize()
        simulator = Simulator(plant)
        if scheme:
            ResetIntegratorFromFlags(simulator, scheme, END / steps)
            simulator.get_mutable_integrator().set_fixed_step_mode(True)
        context = simulator.get_mutable_context()
        plant.SetPositions(context, [1.0, 0, 0, 0, 0, 0, 0])
        plant.SetVelocities(context, [*RATE, 0.0, 0.0, 0.0])
        simulator.Initialize()
        simulator.AdvanceTo(END)
        pose: RotationMatrix = plant.EvalBodyPoseInWorld(context, body).rotation()
        return Rotation.from_matrix(pose.matrix())

    schemes = ("runge_kutta2", "runge_kutta3", "runge_kutta5", "explicit_euler", "")
    for name in schemes:
        yield name or "discrete plant", partial(turn, name)


def pybullet() -> Iterator[tuple[str, Turn]]:
    """Yield the step of Bullet."""
    import pybullet as bullet

    def turn(steps: int) -> Rotation:
        client = bullet.connect(bullet.DIRECT)
        bullet.setPhysicsEngineParameter(fixedTimeStep=END / steps, physicsClientId=client)
        body = bullet.createMultiBody(baseMass=1.0, physicsClientId=client)
        bullet.changeDynamics(
            body, -1, localInertiaDiagonal=INERTIA, linearDamping=0.0, angularDamping=0.0,
            physicsClientId=client,
        )  # fmt: skip
        bullet.resetBaseVelocity(body, (0, 0, 0), RATE, physicsClientId=client)
        for _ in range(steps):
            bullet.stepSimulation(physicsClientId=client)
        _, quaternion = bullet.getBasePositionAndOrientation(body, physicsClientId=client)
        bullet.disconnect(client)
        return Rotation.from_quat(quaternion)

    yield "step", turn


def dartpy() -> Iterator[tuple[str, Turn]]:
    """Yield the step of DART."""
    import dartpy as dart

    def turn(steps: int) -> Rotation:
        world = dart.simulation.World()
        world.setGravity([0.0, 0.0, 0.0])
        world.setTimeStep(END / steps)
        skeleton = dart.dynamics.Skeleton()
        joint, body = skeleton.createFreeJointAndBodyNodePair()
        inertia = dart.dynamics.Inertia(1.0, np.zeros(3), np.diag(INERTIA))
        body.setInertia(inertia)
        joint.setVelocities([*RATE, 0.0, 0.0, 0.0])
        world.addSkeleton(skeleton)
        for _ in range(steps):
            world.step()
        return Rotation.from_matrix(body.getWorldTransform().rotation())

    yield "step", turn


def crouch_grossman() -> Iterator[tuple[str, Turn]]:
    """Yield fixed steps of two methods of this package."""
    body = cg.problems.FreeRigidBody(INERTIA, tuple(np.multiply(INERTIA, RATE)))

    def turn(name: str, steps: int) -> Rotation:
        run = cg.integrate(body.f, (0, END), body.y0, frame=body.frame, method=name, h=END / steps)
        return Rotation.from_matrix(run.y[-1, :9].reshape(3, 3))

    for name in ("CF4", "RKMK5(4)"):
        yield name, partial(turn, name)


SIMULATORS = (mujoco, pin, crocoddyl, drake, pybullet, dartpy, crouch_grossman)


def errors_of(turn: Turn, counts: tuple[int, ...] = STEPS) -> list[float]:
    """Return the angles (rad) between the attitudes after numbers of steps and the reference."""
    body = cg.problems.FreeRigidBody(INERTIA, tuple(np.multiply(INERTIA, RATE)))
    exact = Rotation.from_matrix(body.reference([END]).y[-1, :9].reshape(3, 3))
    return [float((exact.inv() * turn(steps)).magnitude()) for steps in counts]


def main() -> None:
    """Measure what can be imported, and store it."""
    stored = json.loads(DATA.read_text("utf-8")) if DATA.exists() else []
    rows = {(row["package"], row["version"], row["integrator"]): row for row in stored}
    for simulator in SIMULATORS:
        package = simulator.__name__.replace("_", "-")
        try:
            integrators = list(simulator())
        except ImportError:
            continue
        for name, turn in integrators:
            errors = errors_of(turn)
            slope = observed_order([END / n for n in STEPS], errors, floor=FLOOR).order
            key = (package, version(package), name)
            print(*key, f"{slope:.2f}", f"{errors[-1]:.1e}")
            rows[key] = {
                "package": package,
                "version": version(package),
                "integrator": name,
                "steps": STEPS,
                "errors": errors,
                "slope": slope,
            }
    DATA.write_text(json.dumps(list(rows.values()), indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
