"""The residual without and with an effect, as an SVG: residual.py REPORT.json EFFECT "title" > plot.svg

The points are the evidence in the report of ft-identify: measured less modelled effort on strokes held out of the fit, against the
variable that the effect depends on. Points far beyond all but one in two hundred are not drawn. Standard library only.
"""

import json
import sys
from html import escape

UNITS = {"q": ("m", "rad"), "dq": ("m/s", "rad/s"), "ddq": ("m/s²", "rad/s²"), "time": ("s", "s")}
WIDTH, LEFT, TOP, WIDE, HIGH, APART = 760, 46, 44, 314, 172, 366


def rms(values):
    return (sum(v * v for v in values) / len(values)) ** 0.5


def panel(left, x, y, most, said, unit):
    low, high = min(x), max(x)
    top = lambda v: TOP + HIGH * (0.5 - 0.5 * v / most)
    side = lambda v: left + WIDE * (v - low) / (high - low)
    out = [
        f'<rect x="{left}" y="{TOP}" width="{WIDE}" height="{HIGH}" fill="none" stroke="#999"/>',
        f'<line x1="{left}" x2="{left + WIDE}" y1="{top(0):.1f}" y2="{top(0):.1f}" stroke="#ccc"/>',
        f'<text x="{left}" y="{TOP - 6}">{said}</text>',
    ]
    out += [f'<text x="{left - 4}" y="{top(v) + 4:.1f}" text-anchor="end">{v:.2g}</text>' for v in (-most, 0, most)]
    out += [f'<text x="{side(v):.1f}" y="{TOP + HIGH + 14}" text-anchor="middle">{v:.2g}</text>' for v in (low, high)]
    out.append(f'<text x="{left + WIDE / 2}" y="{TOP + HIGH + 30}" text-anchor="middle">{unit}</text>')
    dots = "".join(f"M{side(a):.1f} {top(b):.1f}h0" for a, b in zip(x, y) if abs(b) <= most)
    out.append(f'<path d="{dots}" stroke="#246" stroke-width="2" stroke-linecap="round" opacity="0.5"/>')
    return out


def main():
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    path, name, title = sys.argv[1:]
    with open(path, encoding="utf-8") as file:
        report = json.load(file)
    named = [effect for effect in report["effects"] if effect["name"] == name]
    if not named:
        sys.exit(f"{path} names no {name}")
    evidence = named[0]["evidence"]
    x, before, after = evidence["x"], evidence["before"], evidence["after"]
    sizes = sorted(abs(v) for v in before + after)
    most = 1.1 * sizes[int(0.995 * (len(sizes) - 1))]
    force = "N" if report["joint"]["kind"] == "prismatic" else "N m"
    unit = UNITS.get(evidence["variable"], ("", ""))[force == "N m"]
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="260" viewBox="0 0 {WIDTH} 260" font-family="sans-serif" font-size="11">',
        f'<rect width="{WIDTH}" height="260" fill="#fff"/><text x="10" y="16" font-size="13">{escape(title)}</text>',
    ]
    for k, (values, said) in enumerate([(before, "without it"), (after, "with it")]):
        out += panel(LEFT + k * APART, x, values, most, f"{said}: {rms(values):.3g} {force} rms of these points", unit)
    print("\n".join([*out, "</svg>"]))


if __name__ == "__main__":
    main()
