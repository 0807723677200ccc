#!/usr/bin/env python3
"""Writes tests/data/state_dict/: small files of torch.save in both of its containers.

    pip install torch
    python tests/support/state_dict_reference.py tests/data/state_dict

`zip.pth` and `legacy.pth` hold the same state dict, `module.pth` a whole layer, which is no state dict,
`transposed.pth` a tensor that is not stored in row-major order.
"""

import sys
from collections import OrderedDict
from pathlib import Path

import torch

out = Path(sys.argv[1])
out.mkdir(parents=True, exist_ok=True)
count = lambda start, *shape: (torch.arange(torch.Size(shape).numel()) + start).reshape(shape).float() / 8

shared = count(100, 10)
tensors = OrderedDict(
    {
        "features.0.weight": count(0, 2, 3, 2, 2),
        "features.0.bias": count(50, 2),
        "lin0.model.1.weight": count(60, 1, 3, 1, 1),
        "half": count(70, 5).half(),
        "parameter": torch.nn.Parameter(count(80, 2, 2)),
        # two parts of one storage
        "first": shared[:4],
        "second": shared[4:].reshape(2, 3),
        "scalar": torch.tensor(1.5),
        "empty": torch.zeros(0, 3),
    }
)
tensors._metadata = OrderedDict([("", {"version": 1}), ("features", {"version": 2})])

torch.save(tensors, out / "zip.pth")
torch.save(tensors, out / "legacy.pth", _use_new_zipfile_serialization=False)
torch.save(torch.nn.Linear(2, 1), out / "module.pth")
torch.save({"features.0.weight": count(0, 2, 3).T}, out / "transposed.pth")
