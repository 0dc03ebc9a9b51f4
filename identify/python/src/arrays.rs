//! Numbers and arrays as arguments, arrays as answers.

use numpy::ndarray::{ArrayD, IxDyn};
use ft_identify::twin::{Each, Evaluator};
use numpy::{IntoPyArray, PyReadonlyArrayDyn, PyReadwriteArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyFloat, PyInt};

use crate::wrong;

/// A number, or an array of doubles in C order.
#[derive(Debug)]
enum Values<'py> {
    One(f64),
    Many(PyReadonlyArrayDyn<'py, f64>),
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

    fn each(&self) -> PyResult<Each<'_>> {
        match self {
            Self::One(value) => Ok(Each::Same(*value)),
            Self::Many(array) => Ok(Each::Own(array.as_slice().map_err(wrong)?)),
        }
    }
}

/// Number `i` of a quantity.
fn at(each: Each<'_>, i: usize) -> f64 {
    match each {
        Each::Same(value) => value,
        Each::Own(values) => values[i],
    }
}

type Arguments<'a, 'py> = [(&'static str, &'a Bound<'py, PyAny>); 3];

/// The arguments, and the shape that all arrays among them have; none when all are numbers.
fn values<'py>(arguments: Arguments<'_, 'py>) -> PyResult<([Values<'py>; 3], Option<Vec<usize>>)> {
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
    let shape = shape.map(|(_, shape)| shape.to_vec());
    Ok((values, shape))
}

/// Efforts at states: a float for three numbers, else an array of the shape that all arrays have; `out` itself when it is given.
pub(crate) fn efforts<'py>(
    evaluator: &Evaluator,
    arguments: Arguments<'_, 'py>,
    out: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let py = arguments[0].1.py();
    let (values, shape) = values(arguments)?;
    let [q, dq, ddq] = [values[0].each()?, values[1].each()?, values[2].each()?];
    let into = |efforts: &mut [f64]| py.detach(|| evaluator.efforts(q, dq, ddq, efforts)).map_err(wrong);
    let Some(out) = out else {
        let Some(shape) = shape else {
            let effort = evaluator.effort(at(q, 0), at(dq, 0), at(ddq, 0));
            return Ok(PyFloat::new(py, effort).into_any());
        };
        let mut efforts = vec![0.0; shape.iter().product()];
        into(&mut efforts)?;
        let array = ArrayD::from_shape_vec(IxDyn(&shape), efforts).map_err(wrong)?;
        return Ok(array.into_pyarray(py).into_any());
    };
    let refused = |why: String| wrong(format!("`out` {why}: give an array of doubles in C order that is none of the others"));
    let mut array: PyReadwriteArrayDyn<'py, f64> = out.extract().map_err(|error| refused(format!("is unfit ({error})")))?;
    if shape.as_deref().is_some_and(|wanted| wanted != array.shape()) {
        return Err(refused(format!("has shape {:?}, the states {:?}", array.shape(), shape.unwrap_or_default())));
    }
    into(array.as_slice_mut().map_err(|error| refused(error.to_string()))?)?;
    Ok(out.clone())
}

/// What `f` gives for each state: a float for three numbers, else an array of the shape that all arrays have.
pub(crate) fn over_states<'py>(
    arguments: Arguments<'_, 'py>,
    f: impl Fn(f64, f64, f64) -> f64 + Sync,
) -> PyResult<Bound<'py, PyAny>> {
    let py = arguments[0].1.py();
    let (values, shape) = values(arguments)?;
    let [q, dq, ddq] = [values[0].each()?, values[1].each()?, values[2].each()?];
    let one = |i| f(at(q, i), at(dq, i), at(ddq, i));
    let Some(shape) = shape else {
        return Ok(PyFloat::new(py, one(0)).into_any());
    };
    let count = shape.iter().product();
    let all: Vec<f64> = py.detach(|| (0..count).map(one).collect());
    let array = ArrayD::from_shape_vec(IxDyn(&shape), all).map_err(wrong)?;
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
