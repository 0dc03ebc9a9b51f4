//! Numbers and arrays as arguments, arrays as answers.

use numpy::ndarray::{ArrayD, IxDyn};
use numpy::{IntoPyArray, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyFloat, PyInt};

use crate::wrong;

/// A number, or an array of doubles in C order.
#[derive(Debug)]
enum Values<'py> {
    One(f64),
    Many(PyReadonlyArrayDyn<'py, f64>),
}

/// Where to take a number for the state of an index.
#[derive(Clone, Copy)]
enum View<'a> {
    One(f64),
    Many(&'a [f64]),
}

impl View<'_> {
    fn at(self, i: usize) -> f64 {
        match self {
            Self::One(value) => value,
            Self::Many(values) => values[i],
        }
    }
}

impl<'py> Values<'py> {
    fn of(value: &Bound<'py, PyAny>) -> PyResult<Self> {
        if value.is_instance_of::<PyFloat>() || value.is_instance_of::<PyInt>() {
            return Ok(Self::One(value.extract()?));
        }
        let numpy = value.py().import("numpy")?;
        // Contiguous doubles come back as they are. A zero-dimensional array becomes one of one element only there.
        let array = numpy.call_method1("asarray", (value, "float64", "C"))?;
        let array: PyReadonlyArrayDyn<'py, f64> = array.extract()?;
        match array.shape() {
            [] => Ok(Self::One(value.extract()?)),
            _ => Ok(Self::Many(array)),
        }
    }

    fn view(&self) -> PyResult<View<'_>> {
        match self {
            Self::One(value) => Ok(View::One(*value)),
            Self::Many(array) => Ok(View::Many(array.as_slice().map_err(wrong)?)),
        }
    }
}

/// What `f` gives for each state: a float for three numbers, else an array of the shape that all arrays have.
pub(crate) fn over_states<'py>(
    arguments: [(&str, &Bound<'py, PyAny>); 3],
    f: impl Fn(f64, f64, f64) -> f64 + Sync,
) -> PyResult<Bound<'py, PyAny>> {
    let [(_, first), ..] = arguments;
    let py = first.py();
    let [q, dq, ddq] = arguments.map(|(_, value)| Values::of(value));
    let values = [q?, dq?, ddq?];
    let mut shape: Option<(&str, &[usize])> = None;
    for (value, (name, _)) in values.iter().zip(arguments) {
        let Values::Many(array) = value else { continue };
        match shape {
            None => shape = Some((name, array.shape())),
            Some((first, wanted)) if wanted != array.shape() => {
                return Err(wrong(format!(
                    "`{first}` has shape {wanted:?}, `{name}` has {:?}: give arrays of one shape, or numbers",
                    array.shape()
                )));
            }
            Some(_) => {}
        }
    }
    let [q, dq, ddq] = [values[0].view()?, values[1].view()?, values[2].view()?];
    let Some((_, shape)) = shape else {
        let value = f(q.at(0), dq.at(0), ddq.at(0));
        return Ok(PyFloat::new(py, value).into_any());
    };
    let count = shape.iter().product();
    let efforts: Vec<f64> = py.detach(|| match (q, dq, ddq) {
        // The usual cases without a choice per number.
        (View::Many(q), View::Many(dq), View::Many(ddq)) => q
            .iter()
            .zip(dq)
            .zip(ddq)
            .map(|((q, dq), ddq)| f(*q, *dq, *ddq))
            .collect(),
        _ => (0..count)
            .map(|i| f(q.at(i), dq.at(i), ddq.at(i)))
            .collect(),
    });
    let array = ArrayD::from_shape_vec(IxDyn(shape), efforts).map_err(wrong)?;
    Ok(array.into_pyarray(py).into_any())
}

/// Rows of numbers as a two-dimensional array.
pub(crate) fn rows<'py, const N: usize>(
    py: Python<'py>,
    rows: impl ExactSizeIterator<Item = [f64; N]>,
) -> PyResult<Bound<'py, PyAny>> {
    let shape = IxDyn(&[rows.len(), N]);
    let array = ArrayD::from_shape_vec(shape, rows.flatten().collect()).map_err(wrong)?;
    Ok(array.into_pyarray(py).into_any())
}
