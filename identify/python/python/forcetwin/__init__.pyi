"""Identified twins of doors and drawers: their effort over NumPy arrays, recordings, the identification.

SI units: q in rad or m, efforts in N m or N. An effort is what the tool applies to the object, so what resists a motion has the
motion's sign. Errors are `ValueError` (wrong argument, not a twin) and `RuntimeError` (not identifiable), with what to do.
"""
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import attach as attach

_Path = str | PathLike[str]
_Floats = NDArray[np.float64]

class Twin:
    """A `twin.json`, ready for evaluation. Parameters that were not identified count as 0."""

    @staticmethod
    def load(path: _Path) -> Twin: ...
    @staticmethod
    def from_json(text: str) -> Twin: ...
    def to_json(self) -> str: ...
    @property
    def kind(self) -> str:
        """`revolute` or `prismatic`."""
    @property
    def inertia(self) -> float:
        """kg m^2 or kg; 0 when it was not identified."""
    @property
    def q_range(self) -> tuple[float, float]: ...
    @property
    def domain(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Probed q and dq, lowest and highest."""
    @property
    def radius(self) -> float | None:
        """Distance of the handle from the axis, m; None for a slide or a table."""
    @property
    def left_out(self) -> list[str]:
        """Effects with a memory, which no evaluation has."""
    @property
    def not_identified(self) -> list[str]:
        """Parameters that the data did not show, which count as 0."""
    @overload
    def effort(self, q: float, dq: float, ddq: float = 0.0) -> float: ...
    @overload
    def effort(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike = 0.0, out: _Floats | None = None) -> _Floats:
        """Effort at states. Each argument is a number or an array; all arrays have one shape. `out`, of that shape, receives the
        efforts and is given back: nothing is allocated. Other Python threads run meanwhile."""
    def terms(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike = 0.0) -> dict[str, Any]:
        """`inertia`, `coulomb`, `viscous`, `effects`, `mechanism`: their sum is the effort."""
    def gradient(self, q: float, dq: float) -> tuple[float, float, float]:
        """Derivative of the effort by q, dq and ddq, the direction of motion held."""
    def outside(self, q: float, dq: float) -> str | None:
        """`coordinate` or `velocity` when that was not probed: the effort then goes on from the edge and means nothing."""
    @property
    def axis(self) -> tuple[list[float], list[float]] | None:
        """Unit direction and a point, m, in the twin's frame; None for a table."""
    @property
    def tool(self) -> list[float] | None:
        """Where the tool holds the part at q = 0, m; None for a table."""
    def rigid_body(self) -> dict[str, Any]:
        """A body that moves about the joint as the part does, its centre of mass on the axis: `origin`, `mass`, `inertia` (x along
        the joint), `quaternion` of the principal axes (w x y z), in the twin's frame at q = 0."""
    def export(self, to: str, directory: _Path, name: str = "object", force: bool = False) -> list[Path]:
        """As `ft-identify export`: `mjcf`, `urdf`, `usd` or `onnx`; the files, the main one first."""
    def in_coordinate(self, reversed: bool, offset: float) -> Twin:
        """The twin in the coordinate `q + offset`, or `-q + offset` when reversed."""
    def in_frame(self, name: str, name_from_old: ArrayLike) -> Twin:
        """The twin in another frame; a 4x4 rigid transform from the old frame's coordinates."""
    def release(self, start: float, until: float | None = None, longest: float = 30.0) -> dict[str, Any]:
        """Let go at rest at `start`: `time`, `q`, `dq` as arrays, `end` (`arrived`, `held`, `left`, `moving`)."""
    def demand(self, to: float, within: float = 6.0, limit: float | None = None) -> dict[str, Any]:
        """What an opening from the lower end of the range to `to` takes: `time`, `q`, `dq`, `effort`, `peak`, `peak_at`,
        `not_probed`; with a limit (N m or N) `exceeds_at` and `enough_within`, the shortest time for which it is enough."""

class Samples:
    """Wrench and pose of a recording on one grid, at the wrench's rate; rows are samples."""

    time: _Floats
    """s from the first wrench."""
    position: _Floats
    """(n, 3): origin of `tcp` in `world`, m."""
    quaternion: _Floats
    """(n, 4): `world_from_tcp`, x y z w."""
    wrench: _Floats
    """(n, 6): force then torque, environment on tool, as recorded, N and N m in `ft_sensor`."""
    runs: list[tuple[int, int]]
    """Gapless pieces, as [first, after last)."""
    start_ns: int
    """Unix time of time 0, ns."""

class Identified:
    """What `ft-identify` finds."""

    report: dict[str, Any]
    """report.json."""
    twin: Twin | None
    """None when the dynamics are not identifiable; the report says why."""
    time: _Floats
    """s; up to 200 a second."""
    q: _Floats
    """Joint coordinate as measured, rad or m."""
    tau: _Floats
    """Effort applied to the object as measured, N m or N."""
    runs: list[tuple[int, int]]

def read(path: _Path, topics: dict[str, str] | None = None) -> Samples:
    """Reads any MCAP that keeps the reader's contract. `topics` maps {"/their/topic": "/ft/wrench"}."""

def identify(path: _Path, confirm: Sequence[_Path] = (), topics: dict[str, str] | None = None) -> Identified:
    """The whole pipeline: joint, dynamics, mechanism, diagnosis."""
