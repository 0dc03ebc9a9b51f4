//! The class `Twin`.

use std::path::PathBuf;

use ft_identify::export::{Scene, Target, export};
use ft_identify::simulate::{End, Opening, Release, demand, refuse_outside, release, shortest};
use ft_identify::twin::{Evaluator, Outside, Twin as Identified};
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use numpy::IntoPyArray;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{efforts, over_states};
use crate::{impossible, wrong};

/// A `twin.json`, ready for evaluation.
#[pyclass(module = "forcetwin", frozen)]
#[derive(Debug)]
pub(crate) struct Twin {
    twin: Identified,
    evaluator: Evaluator,
}

/// Step of the simulation, s.
const STEP: f64 = 1e-4;
/// How far from a rotation the matrix of a transform may be.
const NEARLY: f64 = 1e-6;

impl From<Identified> for Twin {
    fn from(twin: Identified) -> Self {
        let evaluator = twin.evaluator();
        Self { twin, evaluator }
    }
}

#[pymethods]
impl Twin {
    /// Reads a twin.json.
    #[staticmethod]
    fn load(path: PathBuf) -> PyResult<Self> {
        let text = std::fs::read_to_string(&path).map_err(|error| {
            std::io::Error::new(error.kind(), format!("{}: {error}", path.display()))
        })?;
        Self::from_json(&text).map_err(|error| wrong(format!("{}: {error}", path.display())))
    }

    /// Reads the text of a twin.json.
    #[staticmethod]
    fn from_json(text: &str) -> PyResult<Self> {
        Identified::from_json(text).map(Self::from).map_err(wrong)
    }

    /// The text of a twin.json.
    fn to_json(&self) -> PyResult<String> {
        self.twin.to_json().map_err(wrong)
    }

    /// `revolute` or `prismatic`.
    #[getter]
    fn kind(&self) -> &'static str {
        self.twin.joint.kind.name()
    }

    /// kg m^2 or kg; 0 when it was not identified.
    #[getter]
    fn inertia(&self) -> f64 {
        self.evaluator.inertia()
    }

    /// Probed range of the joint, rad or m.
    #[getter]
    fn q_range(&self) -> (f64, f64) {
        self.twin.joint.q_range.into()
    }

    /// Probed q and dq, lowest and highest.
    #[getter]
    fn domain(&self) -> ((f64, f64), (f64, f64)) {
        let domain = self.evaluator.domain();
        (domain.q.into(), domain.dq.into())
    }

    /// Distance of the handle from the axis, m; None for a slide or a table.
    #[getter]
    fn radius(&self) -> Option<f64> {
        self.twin.radius()
    }

    /// Effects with a memory, which no evaluation has.
    #[getter]
    fn left_out(&self) -> Vec<String> {
        self.twin.left_out().map(str::to_owned).collect()
    }

    /// Parameters that the data did not show, which count as 0.
    #[getter]
    fn not_identified(&self) -> Vec<String> {
        self.twin.not_identified().map(str::to_owned).collect()
    }

    /// Effort at states: each argument a number or an array, all arrays of one shape; into `out` when it is given.
    #[pyo3(signature = (q, dq, ddq = None, out = None))]
    fn effort<'py>(
        &self,
        q: &Bound<'py, PyAny>,
        dq: &Bound<'py, PyAny>,
        ddq: Option<&Bound<'py, PyAny>>,
        out: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let zero = pyo3::types::PyFloat::new(q.py(), 0.0).into_any();
        let ddq = ddq.unwrap_or(&zero);
        efforts(&self.evaluator, [("q", q), ("dq", dq), ("ddq", ddq)], out)
    }

    /// The effort's terms: `inertia`, `coulomb`, `viscous`, `effects`, `mechanism`.
    #[pyo3(signature = (q, dq, ddq = None))]
    fn terms<'py>(
        &self,
        q: &Bound<'py, PyAny>,
        dq: &Bound<'py, PyAny>,
        ddq: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let zero = pyo3::types::PyFloat::new(q.py(), 0.0).into_any();
        let states = [("q", q), ("dq", dq), ("ddq", ddq.unwrap_or(&zero))];
        let terms = |q, dq, ddq| self.evaluator.terms(q, dq, ddq);
        let out = PyDict::new(q.py());
        out.set_item(
            "inertia",
            over_states(states, |q, dq, ddq| terms(q, dq, ddq).inertia)?,
        )?;
        out.set_item(
            "coulomb",
            over_states(states, |q, dq, ddq| terms(q, dq, ddq).coulomb)?,
        )?;
        out.set_item(
            "viscous",
            over_states(states, |q, dq, ddq| terms(q, dq, ddq).viscous)?,
        )?;
        out.set_item(
            "effects",
            over_states(states, |q, dq, ddq| terms(q, dq, ddq).effects)?,
        )?;
        out.set_item(
            "mechanism",
            over_states(states, |q, dq, ddq| terms(q, dq, ddq).mechanism)?,
        )?;
        Ok(out)
    }

    /// Derivative of the effort by q, dq and ddq, the direction of motion held.
    fn gradient(&self, q: f64, dq: f64) -> (f64, f64, f64) {
        self.evaluator.gradient(q, dq).into()
    }

    /// `coordinate` or `velocity` when that was not probed.
    fn outside(&self, q: f64, dq: f64) -> Option<&'static str> {
        self.evaluator.outside(q, dq).map(|outside| match outside {
            Outside::Coordinate => "coordinate",
            Outside::Velocity => "velocity",
        })
    }

    /// Direction of the axis and a point on it, in the twin's frame; None for a table.
    #[getter]
    fn axis(&self) -> Option<([f64; 3], [f64; 3])> {
        let joint = &self.twin.joint;
        joint.axis_direction.zip(joint.axis_point)
    }

    /// Where the tool holds the part at the twin's q = 0, m; None for a table.
    #[getter]
    fn tool(&self) -> Option<[f64; 3]> {
        self.twin.tool_at_zero().map(|point| point.coords.into())
    }

    /// A rigid body that moves about the joint as the part does, in the twin's frame at q = 0: `origin` (its centre of mass, on
    /// the axis), `mass`, `inertia` about the principal axes whose x is the joint's, `quaternion` of those, w x y z.
    fn rigid_body<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let scene = Scene::of(&self.twin);
        let turn = scene.x_to_axis;
        let out = PyDict::new(py);
        out.set_item("origin", <[f64; 3]>::from(scene.origin.coords))?;
        out.set_item("mass", scene.mass)?;
        out.set_item("inertia", scene.inertia)?;
        out.set_item("quaternion", [turn.w, turn.i, turn.j, turn.k])?;
        Ok(out)
    }

    /// Writes `name.*` for other simulators: `mjcf`, `urdf`, `usd`, `onnx`. Gives the files, the main one first.
    #[pyo3(signature = (to, directory, name = "object", force = false))]
    fn export(
        &self,
        to: &str,
        directory: PathBuf,
        name: &str,
        force: bool,
    ) -> PyResult<Vec<PathBuf>> {
        let target = match to {
            "mjcf" => Target::Mjcf,
            "urdf" => Target::Urdf,
            "usd" => Target::Usd,
            "onnx" => Target::Onnx,
            _ => {
                return Err(wrong(format!(
                    "`{to}` is no format: mjcf, urdf, usd or onnx"
                )));
            }
        };
        let done = export(&self.twin, &[target], &directory, name, force).map_err(impossible)?;
        Ok(done.into_iter().flat_map(|one| one.files).collect())
    }

    /// The twin in the coordinate `q + offset`, or `-q + offset` when reversed.
    fn in_coordinate(&self, reversed: bool, offset: f64) -> Self {
        self.twin.in_coordinate(reversed, offset).into()
    }

    /// The twin in another frame; a 4x4 rigid transform from the old frame's coordinates.
    fn in_frame(&self, name: &str, name_from_old: [[f64; 4]; 4]) -> PyResult<Self> {
        let m = name_from_old;
        let turn = Matrix3::from_fn(|i, j| m[i][j]);
        let off = (turn.transpose() * turn - Matrix3::identity()).norm();
        // Not `off > NEARLY`: a NaN is no rotation either.
        if !(off <= NEARLY && turn.determinant() > 0.0) || m[3] != [0.0, 0.0, 0.0, 1.0] {
            return Err(wrong(
                "name_from_old is no rigid transform: give a rotation and a translation in 4x4, last row 0 0 0 1",
            ));
        }
        let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(turn));
        let way = Translation3::from(Vector3::new(m[0][3], m[1][3], m[2][3]));
        let transform = Isometry3::from_parts(way, turn);
        Ok(self.twin.in_frame(name, &transform).into())
    }

    /// Let go at rest at `start`, until `until` (the lower end of the range).
    #[pyo3(signature = (start, until = None, longest = 30.0))]
    fn release<'py>(
        &self,
        py: Python<'py>,
        start: f64,
        until: Option<f64>,
        longest: f64,
    ) -> PyResult<Bound<'py, PyDict>> {
        let range = self.twin.joint.q_range;
        let how = Release {
            from: start,
            until: until.unwrap_or(range[0]),
            step: STEP,
            longest,
        };
        let swing = py
            .detach(|| release(&self.evaluator, range, &how))
            .map_err(impossible)?;
        let out = PyDict::new(py);
        out.set_item(
            "end",
            match swing.end {
                End::Arrived { .. } => "arrived",
                End::Held { .. } => "held",
                End::Left { .. } => "left",
                End::Moving { .. } => "moving",
            },
        )?;
        out.set_item("time", swing.time.into_pyarray(py))?;
        out.set_item("q", swing.q.into_pyarray(py))?;
        out.set_item("dq", swing.dq.into_pyarray(py))?;
        out.set_item("beyond_probed_speed", swing.beyond_probed_speed)?;
        Ok(out)
    }

    /// What an opening from the lower end of the range takes.
    #[pyo3(signature = (to, within = 6.0, limit = None))]
    fn demand<'py>(
        &self,
        py: Python<'py>,
        to: f64,
        within: f64,
        limit: Option<f64>,
    ) -> PyResult<Bound<'py, PyDict>> {
        if !(within > 0.0 && within.is_finite() && to.is_finite()) {
            return Err(wrong(format!(
                "to = {to}, within = {within}: give a place and a time above 0 s"
            )));
        }
        let opening = Opening {
            from: self.twin.joint.q_range[0],
            to,
            duration: within,
        };
        refuse_outside(&self.evaluator, self.twin.joint.q_range, to).map_err(impossible)?;
        let needed = demand(&self.evaluator, &opening);
        let out = PyDict::new(py);
        if let Some(limit) = limit {
            out.set_item("exceeds_at", needed.exceeds(limit))?;
            out.set_item("enough_within", shortest(&self.evaluator, &opening, limit))?;
        }
        out.set_item("peak", needed.peak)?;
        out.set_item("peak_at", needed.peak_at)?;
        out.set_item("not_probed", needed.not_probed)?;
        out.set_item("time", needed.time.into_pyarray(py))?;
        out.set_item("q", needed.q.into_pyarray(py))?;
        out.set_item("dq", needed.dq.into_pyarray(py))?;
        out.set_item("effort", needed.effort.into_pyarray(py))?;
        Ok(out)
    }

    fn __repr__(&self) -> String {
        format!(
            "<Twin {}, inertia {:.4} {}>",
            self.kind(),
            self.inertia(),
            self.twin.joint.kind.inertia_unit()
        )
    }
}
