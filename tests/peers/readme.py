"""Runs the Python of the README's section "Use the twin" as it stands there, block after block.

    readme.py README.md        in a folder with twin/, assets/ and door.mcap, as the section's commands make them

Prints one JSON object with what came of it; the test that runs this has the bounds.
"""
import contextlib
import io
import json
import re
import sys

import numpy as np

text = open(sys.argv[1]).read()
section = text[text.index("## Use the twin"):]
section = section[: section.index("\n## ", 5)]
blocks = re.findall(r"```python\n(.*?)```", section, re.S)
names, found = {}, {"blocks": len(blocks)}
for number, block in enumerate(blocks):
    with contextlib.redirect_stdout(io.StringIO()):
        exec(compile(block, f"README.md, Python block {number + 1}", "exec"), names)
    if number == 0:
        found["callback_installed"] = names["mujoco"].get_mjcb_passive() is not None
        names["mujoco"].set_mjcb_passive(None)
import forcetwin

twin = forcetwin.Twin.load("twin/twin.json")
effort = twin.effort(*(names[v].astype(float) for v in ("q", "dq")), names["ddq"].astype(float))
found["onnx_off"] = float(np.sqrt(np.mean((names["effort"] - effort) ** 2) / np.mean(effort**2)))
# On the reference the feed-forward is all the force.
state = 0.4, 0.2, 0.1
r = twin.radius
found["force_off"] = abs(names["force"](*state, r * state[0], r * state[1]) - twin.effort(*state) / r)
found["report"] = names["found"].report["schema"]
print(json.dumps(found))
