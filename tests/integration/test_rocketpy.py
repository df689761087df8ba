"""A flight of RocketPy with a solver of this package, through its table of solvers."""

import numpy as np
import pytest

import cg.scipy
from cg.frames import Euclidean, Product, UnitQuaternion

rocketpy = pytest.importorskip("rocketpy")


@pytest.mark.filterwarnings("ignore:The following arguments have no effect:UserWarning")
def test_flight_keeps_the_norm_of_its_quaternion(monkeypatch):
    frame = Product(Euclidean(6), UnitQuaternion(scalar_first=True), Euclidean(3))
    solvers = rocketpy.simulation.flight.ODE_SOLVER_MAP
    monkeypatch.setitem(solvers, "cg", cg.scipy.Solver(frame))
    motor = rocketpy.GenericMotor(
        thrust_source=[[0, 2000], [0.1, 2200], [2.9, 1500], [3, 0]], burn_time=3.0,
        chamber_radius=0.033, chamber_height=0.5, chamber_position=0.3, nozzle_radius=0.033,
        propellant_initial_mass=2.8, dry_mass=1.8, dry_inertia=(0.125, 0.125, 0.002),
        center_of_dry_mass_position=0.3,
    )  # fmt: skip
    rocket = rocketpy.Rocket(0.0635, 14.4, (6.3, 6.3, 0.034), 0.5, 0.5, 0)
    rocket.add_motor(motor, position=-1.25)
    rocket.add_nose(length=0.56, kind="vonKarman", position=1.28)
    rocket.add_trapezoidal_fins(4, 0.12, 0.06, 0.11, position=-1.05, cant_angle=0.5)
    place = rocketpy.Environment(latitude=33, longitude=-107, elevation=1400)
    apogee, off = {}, {}
    for name in ("LSODA", "cg"):
        flight = rocketpy.Flight(
            rocket, place, 5.2, inclination=85, terminate_on_apogee=True, ode_solver=name
        )
        apogee[name] = flight.apogee
        norms = np.linalg.norm(np.array(flight.solution)[:, 7:11], axis=1)
        off[name] = np.abs(norms - 1).max()
    assert off["cg"] < 1e-15 < 1e-5 < off["LSODA"]
    assert apogee["cg"] == pytest.approx(apogee["LSODA"], abs=0.1)
