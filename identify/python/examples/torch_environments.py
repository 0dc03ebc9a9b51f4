"""The mechanism of 10 000 environments at once in PyTorch, on whatever device the tensors are: the table of an exported ONNX file.

    ft-identify export twin/twin.json --to onnx --name door -o assets
    python torch_environments.py assets/door.onnx
"""
import sys

import onnx
import torch

table = {t.name: torch.tensor(onnx.numpy_helper.to_array(t)) for t in onnx.load(sys.argv[1]).graph.initializer}
rows, columns = int(table["last_q"]) + 1, int(table["row"])
efforts = table["efforts"].reshape(2, rows, columns)  # direction, q, sqrt(speed)


def effort(q, dq):
    """Effort without inertia, N m or N: what the mechanism and friction resist with, for q and dq of any equal shape."""
    i = ((q - table["low"]) * table["per_q"]).clamp(0, rows - 1)
    j = (dq.abs() * table["per_speed"]).clamp(0, 1).sqrt() * (columns - 1)
    i0, j0, way = i.long().clamp(max=rows - 2), j.long().clamp(max=columns - 2), (dq < 0).long()
    u, v = i - i0, j - j0
    low = torch.lerp(efforts[way, i0, j0], efforts[way, i0, j0 + 1], v)
    return torch.lerp(low, torch.lerp(efforts[way, i0 + 1, j0], efforts[way, i0 + 1, j0 + 1], v), u)


q, dq = torch.rand(10_000), torch.rand(10_000) - 0.5
print(effort(q, dq).mean())
