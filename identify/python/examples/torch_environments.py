"""The mechanism of 10 000 environments at once in PyTorch, on whatever device the tensors are: the table beside any exported file.

    ft-identify export twin/twin.json --to usd --name door -o assets
    python torch_environments.py assets/door.usda.mechanism.json
"""
import json
import sys

import torch

table = json.load(open(sys.argv[1]))
(low, high), (rows, columns) = table["q"], table["nodes"]
ways = torch.tensor(table["efforts"]).reshape(2, rows, columns)  # direction, q, sqrt(speed)
ways = torch.cat((ways, ways.mean(0, keepdim=True)))  # at rest the middle of both directions


def effort(q, dq):
    """Effort without inertia, N m or N: what the mechanism and friction resist with, for q and dq of any equal shape."""
    i = ((q - low) / (high - low) * (rows - 1)).clamp(0, rows - 1)
    j = dq.abs() / table["speed"] * (columns - 1) ** 2  # nodes at the squares of whole numbers; straight on beyond the last
    i0, j0, way = i.long().clamp(max=rows - 2), j.sqrt().long().clamp(max=columns - 2), (dq < 0) + 2 * (dq == 0)
    u, v = i - i0, (j - j0 * j0) / (2 * j0 + 1)
    below = torch.lerp(ways[way, i0, j0], ways[way, i0, j0 + 1], v)
    return torch.lerp(below, torch.lerp(ways[way, i0 + 1, j0], ways[way, i0 + 1, j0 + 1], v), u)


q, dq = low + (high - low) * torch.rand(10_000), table["speed"] * (torch.rand(10_000) - 0.5)
print(f"10 000 environments: efforts {effort(q, dq).min():.2f} to {effort(q, dq).max():.2f}")
