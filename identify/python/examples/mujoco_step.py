"""A twin in MuJoCo without any exported file: the mechanism's effort is added in every step.

    python mujoco_step.py TWIN.json [RELEASE]      RELEASE in rad or m; by default half of the range

Lets the joint go and prints its swing time beside the twin's own simulation. With an asset of your own take its joint instead,
with `damping`, `frictionloss` and gravity of the part off: the twin has them.
"""
import sys

import forcetwin
import mujoco

twin = forcetwin.Twin.load(sys.argv[1])
low, high = twin.q_range
start = float(sys.argv[2]) if len(sys.argv) > 2 else 0.5 * (low + high)
slide = twin.kind == "prismatic"
friction = twin.terms(start, 1.0)["coulomb"]  # MuJoCo's own dry friction does not chatter at rest
model = mujoco.MjModel.from_xml_string(
    f"""<mujoco><option timestep="0.0005" gravity="0 0 0"/><worldbody><body>
    <inertial pos="0 0 0" mass="{twin.inertia if slide else 1}" diaginertia="{' '.join(3 * ['1' if slide else str(twin.inertia)])}"/>
    <joint name="door" type="{'slide' if slide else 'hinge'}" axis="0 0 1" frictionloss="{friction}"/>
    </body></worldbody></mujoco>"""
)
data = mujoco.MjData(model)


def step():
    q, dq = float(data.qpos[0]), float(data.qvel[0])
    dry = friction * ((dq > 0) - (dq < 0))
    data.qfrc_applied[0] = dry - twin.effort(q, dq)  # what resists has the motion's sign: take it off
    mujoco.mj_step(model, data)


data.qpos[0] = start
while data.qpos[0] > low and data.time < 30:
    step()
ours = twin.release(start)
print(f"MuJoCo {data.time:.3f} s at {data.qpos[0]:.3f}; twin {ours['time'][-1]:.3f} s at {ours['q'][-1]:.3f}, {ours['end']}")
