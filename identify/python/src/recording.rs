//! Recordings as arrays, and the whole identification.

use core::ops::Range;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use ft_identify::motion::MotionSettings;
use ft_identify::pipeline::{Stage, identify_confirmed};
use ft_identify::tool::ToolSamples;
use ft_recording::{Recording, TopicMap};
use numpy::IntoPyArray;
use pyo3::prelude::*;

use crate::arrays::rows;
use crate::twin::Twin;
use crate::{impossible, wrong};

type Runs = Vec<(usize, usize)>;

/// Wrench and pose of a recording on one grid.
#[pyclass(module = "forcetwin", frozen, get_all)]
#[derive(Debug)]
pub(crate) struct Samples {
    time: Py<PyAny>,
    position: Py<PyAny>,
    quaternion: Py<PyAny>,
    wrench: Py<PyAny>,
    runs: Runs,
    start_ns: i64,
}

/// What the identification found.
#[pyclass(module = "forcetwin", frozen, get_all)]
#[derive(Debug)]
pub(crate) struct Identified {
    report: Py<PyAny>,
    twin: Option<Py<Twin>>,
    time: Py<PyAny>,
    q: Py<PyAny>,
    tau: Py<PyAny>,
    runs: Runs,
}

/// Reads any MCAP that keeps the reader's contract.
#[pyfunction]
#[pyo3(signature = (path, topics = None))]
pub(crate) fn read(
    py: Python<'_>,
    path: PathBuf,
    topics: Option<BTreeMap<String, String>>,
) -> PyResult<Samples> {
    let map = topic_map(topics)?;
    let tool = py.detach(|| {
        let recording = Recording::load(&path, &map).map_err(wrong)?;
        ToolSamples::from_recording(&recording).map_err(|error| about(&path, error))
    })?;
    let quaternions = tool.rotation.iter().map(|turn| turn.coords.into());
    Ok(Samples {
        position: rows(py, tool.position.iter().map(|p| p.coords.into()))?.unbind(),
        quaternion: rows(py, quaternions)?.unbind(),
        wrench: rows(py, tool.wrench.iter().copied())?.unbind(),
        runs: pairs(&tool.runs),
        start_ns: tool.start.as_nanos(),
        time: array(py, tool.time),
    })
}

/// The whole pipeline.
#[pyfunction]
#[pyo3(signature = (path, confirm = Vec::new(), topics = None))]
pub(crate) fn identify(
    py: Python<'_>,
    path: PathBuf,
    confirm: Vec<PathBuf>,
    topics: Option<BTreeMap<String, String>>,
) -> PyResult<Identified> {
    let map = topic_map(topics)?;
    let settings = MotionSettings::default();
    let found = py
        .detach(|| identify_confirmed(&path, &confirm, &map, &settings, &mut |_: Stage| {}))
        .map_err(|error| about(&path, error))?;
    let report = serde_json::to_string(&found.report).map_err(impossible)?;
    let twin = found.twin.map(|twin| Py::new(py, Twin::from(twin)));
    Ok(Identified {
        report: py
            .import("json")?
            .call_method1("loads", (report,))?
            .unbind(),
        twin: twin.transpose()?,
        runs: pairs(&found.samples.runs),
        time: array(py, found.samples.time),
        q: array(py, found.samples.q),
        tau: array(py, found.samples.tau),
    })
}

fn topic_map(topics: Option<BTreeMap<String, String>>) -> PyResult<TopicMap> {
    let arguments: Vec<String> = topics
        .unwrap_or_default()
        .iter()
        .map(|(theirs, ours)| format!("{theirs}={ours}"))
        .collect();
    TopicMap::from_arguments(arguments.iter().map(String::as_str)).map_err(wrong)
}

fn about(path: &Path, error: impl core::fmt::Display) -> PyErr {
    impossible(format!("{}: {error}", path.display()))
}

fn pairs(runs: &[Range<usize>]) -> Runs {
    runs.iter().map(|run| (run.start, run.end)).collect()
}

fn array(py: Python<'_>, values: Vec<f64>) -> Py<PyAny> {
    values.into_pyarray(py).into_any().unbind()
}
