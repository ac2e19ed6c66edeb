"""Rendered recordings with known truth: `simulate("room_loop")`."""

from .scenarios import SCENARIOS, Scenario
from .simulate import Simulation, build, simulate

__all__ = ["SCENARIOS", "Scenario", "Simulation", "build", "simulate"]
