//! A motion after a release as a page: plots over time and the joint seen along its axis, moving.

use core::fmt::Write as _;

use super::{End, Swing};
use crate::screw::JointKind;

const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 180.0;
const LEFT: f64 = 60.0;
const BOTTOM: f64 = 28.0;

/// The page, self-contained. `name` is the twin's; plots are in degrees for a turning joint, else in m.
#[must_use]
pub fn page(name: &str, kind: JointKind, swing: &Swing) -> String {
    let (scale, unit) = match kind {
        JointKind::Revolute => (180.0 / core::f64::consts::PI, "deg"),
        JointKind::Prismatic => (1.0, "m"),
    };
    let scaled = |series: &[f64]| series.iter().map(|v| v * scale).collect::<Vec<f64>>();
    let (q, dq) = (scaled(&swing.q), scaled(&swing.dq));
    let points: Vec<String> = swing
        .time
        .iter()
        .zip(&swing.q)
        .map(|(t, q)| format!("[{t:.4},{q:.6}]"))
        .collect();
    let drawing = match kind {
        JointKind::Revolute => {
            "<circle cx='0' cy='0' r='4'/><rect id='part' x='0' y='-3' width='90' height='6'/>"
        }
        JointKind::Prismatic => {
            "<line x1='0' y1='12' x2='100' y2='12' stroke='#888'/><rect id='part' x='0' y='-10' width='30' height='20'/>"
        }
    };
    let turning = kind == JointKind::Revolute;
    format!(
        "<!doctype html><html lang='en'><head><meta charset='utf-8'><meta name='viewport' content='width=device-width'><title>{name}: let go</title>\
<style>body{{font:16px/1.5 system-ui,sans-serif;max-width:700px;margin:2rem auto;padding:0 1rem;color:#222}}svg{{width:100%;height:auto}}\
text{{font:12px system-ui,sans-serif;fill:#444}}#part{{fill:#a47b4e}}button{{font:inherit;padding:.3rem 1rem}}</style></head><body>\
<h1>{name}, let go</h1><p>{said}</p>{q_plot}{dq_plot}\
<p><button id='play'>play</button> <span id='clock'></span></p><svg viewBox='-110 -110 220 {tall}' style='max-width:320px'>{drawing}</svg>\
<p>Simulated from the twin. Effects with memory (presliding, play) are not in it.</p>\
<script>const P=[{points}],part=document.getElementById('part'),clock=document.getElementById('clock');\
const lo=Math.min(...P.map(p=>p[1])),hi=Math.max(...P.map(p=>p[1]));\
function show(t){{let k=P.findIndex(p=>p[0]>=t);if(k<0)k=P.length-1;const q=P[k][1];\
part.setAttribute('transform',{turning}?`rotate(${{-q*180/Math.PI}})`:`translate(${{100*(q-lo)/Math.max(hi-lo,1e-9)-100}},0)`);\
clock.textContent=Math.min(t,P[P.length-1][0]).toFixed(2)+' s'}}\
let start=null;function step(now){{if(start===null)start=now;const t=(now-start)/1000;show(t);if(t<P[P.length-1][0])requestAnimationFrame(step);else start=null}}\
document.getElementById('play').onclick=()=>{{start=null;requestAnimationFrame(step)}};show(0)</script></body></html>\n",
        name = escaped(name),
        said = said(swing, scale, unit),
        q_plot = plot(&swing.time, &q, &format!("coordinate, {unit}")),
        dq_plot = plot(&swing.time, &dq, &format!("velocity, {unit}/s")),
        tall = if turning { 220 } else { 140 },
        points = points.join(","),
    )
}

/// One sentence on how it ended, numbers times `scale` in `unit`.
#[must_use]
pub fn said(swing: &Swing, scale: f64, unit: &str) -> String {
    let mut text = match swing.end {
        End::Arrived { time, speed } => {
            let there = swing.q.last().copied().unwrap_or(f64::NAN);
            format!(
                "arrives at {:.3} {unit} after {time:.3} s, at {:.3} {unit}/s",
                scale * there,
                scale * speed
            )
        }
        End::Held { time: 0.0, q } => {
            format!("stays at {:.3} {unit}: dry friction holds it", scale * q)
        }
        End::Held { time, q } => format!(
            "comes to rest after {time:.3} s at {:.3} {unit}: dry friction holds it",
            scale * q
        ),
        End::Left { time, q } => format!(
            "leaves the probed range after {time:.3} s, at {:.3} {unit}: nothing is known beyond",
            scale * q
        ),
        End::Moving { q } => format!(
            "still moves after {:.1} s, at {:.3} {unit}",
            swing.time.last().copied().unwrap_or(0.0),
            scale * q
        ),
    };
    if swing.beyond_probed_speed > 0.0 {
        let _ = write!(
            text,
            "; {:.0} % of the time it is faster than anything that was probed",
            100.0 * swing.beyond_probed_speed
        );
    }
    text
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('\'', "&#39;")
}

fn plot(time: &[f64], values: &[f64], label: &str) -> String {
    let (low, high) = crate::samples::extrema(values);
    let (low, high) = (low.min(0.0), high.max(low + 1e-9).max(0.0));
    let end = time.last().copied().unwrap_or(1.0).max(1e-9);
    let x = |t: f64| LEFT + (WIDTH - LEFT - 10.0) * t / end;
    let y = |v: f64| 10.0 + (HEIGHT - BOTTOM - 10.0) * (high - v) / (high - low);
    let mut points = String::new();
    for (t, v) in time.iter().zip(values) {
        let _ = write!(points, "{:.1},{:.1} ", x(*t), y(*v));
    }
    let (left, base) = (LEFT, HEIGHT - BOTTOM);
    format!(
        "<svg viewBox='0 0 {WIDTH} {HEIGHT}' role='img' aria-label='{label}'><line x1='{left}' y1='{y0:.1}' x2='{WIDTH}' y2='{y0:.1}' stroke='#bbb'/>\
<line x1='{left}' y1='10' x2='{left}' y2='{base}' stroke='#888'/><polyline points='{points}' fill='none' stroke='#1f5fa8' stroke-width='2'/>\
<text x='{left}' y='{foot}'>0 s</text><text x='{WIDTH}' y='{foot}' text-anchor='end'>{end:.2} s</text><text x='{middle}' y='{foot}' text-anchor='middle'>{label}</text>\
<text x='{beside}' y='16' text-anchor='end'>{high:.3}</text><text x='{beside}' y='{base}' text-anchor='end'>{low:.3}</text></svg>",
        y0 = y(0.0),
        foot = HEIGHT - 8.0,
        middle = 0.5 * (LEFT + WIDTH),
        beside = LEFT - 6.0,
    )
}
