#!/usr/bin/env python3
"""Writes crates/methods/tests/data/networks.safetensors: small networks of CoordNet, InSituNet and ViSNeRF with random weights, inputs, and
what ONNX Runtime makes of them (its convolutions, normalisation by batch, resizing, interpolation on grids).

    pip install onnx onnxruntime numpy safetensors
    python crates/methods/tests/networks_reference.py crates/methods/tests/data/networks.safetensors

Weights stand under the names that our files give them, behind the name of the method; inputs and outputs under `METHOD.check.*`.
"""

import sys

import numpy as np
import onnxruntime
from onnx import TensorProto, helper, numpy_helper
from safetensors.numpy import save_file

RANDOM = np.random.default_rng(20)


class Graph:
    """An ONNX graph that is written as it is computed."""

    def __init__(self):
        self.nodes, self.constants, self.count = [], [], 0

    def constant(self, value, dtype=np.float32):
        return self._named(lambda name: self.constants.append(numpy_helper.from_array(np.array(value, dtype), name)))

    def __call__(self, op, *inputs, outputs=1, **attributes):
        names = [self._named(lambda _: None) for _ in range(outputs)]
        self.nodes.append(helper.make_node(op, list(inputs), names, **attributes))
        return names[0] if outputs == 1 else names

    def _named(self, then):
        self.count += 1
        name = f"v{self.count}"
        then(name)
        return name

    def run(self, outputs):
        values = [helper.make_tensor_value_info(name, TensorProto.FLOAT, None) for name in outputs]
        graph = helper.make_graph(self.nodes, "reference", [], values, self.constants)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
        return onnxruntime.InferenceSession(model.SerializeToString()).run(outputs, {})


class Weights:
    """Random weights, by the names of our files."""

    def __init__(self, graph, method, tensors):
        self.graph, self.method, self.tensors = graph, method, tensors

    def __call__(self, name, shape, spread, middle=0.0):
        value = (middle + spread * RANDOM.uniform(-1, 1, shape)).astype(np.float32)
        self.tensors[f"{self.method}.{name}"] = value
        return self.graph.constant(value)

    def linear(self, x, name, inputs, outputs, bias=True, spread=None):
        spread = spread or 1.5 / np.sqrt(inputs)
        y = self.graph("MatMul", x, self(f"{name}.weight", [inputs, outputs], spread))
        return self.graph("Add", y, self(f"{name}.bias", [outputs], 0.3)) if bias else y

    def conv(self, x, name, inputs, outputs, side, bias):
        weights = [self(f"{name}.weight", [outputs, inputs, side, side], 1.5 / np.sqrt(inputs * side * side))]
        if bias:
            weights.append(self(f"{name}.bias", [outputs], 0.3))
        return self.graph("Conv", x, *weights, kernel_shape=[side] * 2, pads=[side // 2] * 4)

    def norm(self, x, name, channels, training):
        values = [
            self(f"{name}.scale", [channels], 0.4, 1.0),
            self(f"{name}.shift", [channels], 0.3),
            self(f"{name}.running_mean", [channels], 0.3),
            self(f"{name}.running_variance", [channels], 0.4, 1.0),
        ]
        if not training:
            return self.graph("BatchNormalization", x, *values, epsilon=1e-5)
        # ours keep a tenth of the new moments, ONNX counts what it keeps of the old ones
        found = self.graph("BatchNormalization", x, *values, epsilon=1e-5, momentum=0.9, training_mode=1, outputs=3)
        return found[0]


def random_input(tensors, name, shape):
    tensors[name] = RANDOM.uniform(-1, 1, shape).astype(np.float32)
    return tensors[name]


def coordnet(tensors):
    graph = Graph()
    weights = Weights(graph, "coordnet", tensors)
    x = graph.constant(random_input(tensors, "coordnet.check.inputs", [7, 5]))
    omega, half = graph.constant(30.0), graph.constant(0.5)

    def sine(x, name, inputs, outputs):
        bound = np.sqrt(6 / inputs) / 30
        y = graph("MatMul", x, weights(f"{name}.weight", [inputs, outputs], bound))
        y = graph("Add", y, weights(f"{name}.bias", [outputs], 1 / np.sqrt(inputs)))
        return graph("Sin", graph("Mul", y, omega))

    last = 5
    for i, width in enumerate([6, 9, 9, 9, 3]):
        name = f"blocks.{i}"
        inner = sine(x, f"{name}.first", last, width)
        inner = sine(inner, f"{name}.second", width, width)
        skip = x if last == width else sine(x, f"{name}.skip", last, width)
        x, last = graph("Mul", graph("Add", inner, skip), half), width
    tensors["coordnet.check.colours"] = graph.run([x])[0]


def encoded(graph, weights, inputs, width):
    parts = []
    for i, (first, last) in enumerate([(0, 1), (1, 4)]):
        ends = [graph.constant([value], np.int64) for value in (first, last, 1)]
        x = graph("Slice", inputs, *ends)
        for k, n in enumerate([last - first, width]):
            x = graph("Relu", weights.linear(x, f"encoder.groups.{i}.{k}", n, width))
        parts.append(x)
    return graph("Concat", *parts, axis=1)


def generator(tensors, training):
    graph = Graph()
    # the same weights both times
    global RANDOM
    RANDOM = np.random.default_rng(21)
    weights = Weights(graph, "generator", tensors)
    x = graph.constant(random_input(tensors, "generator.check.inputs", [3, 4]))
    width, channels = 5, [6, 4, 3]

    def doubled(x):
        scales = graph.constant([1, 1, 2, 2])
        attributes = dict(mode="nearest", coordinate_transformation_mode="asymmetric", nearest_mode="floor")
        return graph("Resize", x, "", scales, **attributes)

    x = encoded(graph, weights, x, width)
    x = graph("MatMul", x, weights("dense", [2 * width, channels[0] * 16], 0.5))
    x = graph("Reshape", x, graph.constant([3, channels[0], 4, 4], np.int64))
    for i, (a, b) in enumerate(zip(channels, channels[1:])):
        name = f"blocks.{i}"
        inner = graph("Relu", weights.norm(x, f"{name}.norms.0", a, training))
        inner = weights.conv(doubled(inner), f"{name}.convs.0", a, b, 3, False)
        inner = graph("Relu", weights.norm(inner, f"{name}.norms.1", b, training))
        inner = weights.conv(inner, f"{name}.convs.1", b, b, 3, False)
        x = graph("Add", inner, weights.conv(doubled(x), f"{name}.skip", a, b, 1, False))
    x = graph("Relu", weights.norm(x, "norm", channels[-1], training))
    x = graph("Tanh", weights.conv(x, "colour", channels[-1], 3, 3, True))
    sizes = graph.constant([3, 3, 11, 13], np.int64)
    resized = graph("Resize", x, "", "", sizes, mode="linear", coordinate_transformation_mode="half_pixel")
    suffix = "training" if training else "drawing"
    x, resized = graph.run([x, resized])
    tensors[f"generator.check.{suffix}"] = x
    if not training:
        tensors["generator.check.resized"] = resized


def discriminator(tensors):
    graph = Graph()
    weights = Weights(graph, "discriminator", tensors)
    inputs = graph.constant(random_input(tensors, "discriminator.check.inputs", [3, 4]))
    x = graph.constant(random_input(tensors, "discriminator.check.pictures", [3, 3, 16, 16]))
    width, channels = 5, [4, 6]

    def halved(x):
        return graph("AveragePool", x, kernel_shape=[2, 2], strides=[2, 2])

    e = graph("Relu", weights.linear(encoded(graph, weights, inputs, width), "condition", 2 * width, channels[-1]))
    last = 3
    for i, n in enumerate(channels):
        name = f"blocks.{i}"
        inner = weights.conv(graph("Relu", x) if i else x, f"{name}.convs.0", last, n, 3, True)
        inner = weights.conv(graph("Relu", inner), f"{name}.convs.1", n, n, 3, True)
        skip = weights.conv(x if i else halved(x), f"{name}.skip", last, n, 1, True)
        x, last = graph("Add", halved(inner), halved(skip) if i else skip), n
    inner = weights.conv(graph("Relu", x), "last.convs.0", last, last, 3, True)
    inner = weights.conv(graph("Relu", inner), "last.convs.1", last, last, 3, True)
    x = graph("Relu", graph("Add", inner, weights.conv(x, "last.skip", last, last, 1, True)))
    h = graph("ReduceSum", x, graph.constant([2, 3], np.int64), keepdims=0)
    score = weights.linear(h, "score", last, 1)
    product = graph("ReduceSum", graph("Mul", h, e), graph.constant([1], np.int64), keepdims=1)
    tensors["discriminator.check.scores"] = graph.run([graph("Add", score, product)])[0]


def visnerf(tensors):
    graph = Graph()
    weights = Weights(graph, "visnerf", tensors)
    n, resolution, knots, time_ranks, features, width, octaves = 9, [3, 4, 5], 3, 2, 4, 6, 2
    points = random_input(tensors, "visnerf.check.points", [n, 3])
    directions = RANDOM.normal(size=[n, 3])
    directions = (directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype(np.float32)
    tensors["visnerf.check.directions"] = directions
    mixture = graph.constant([[0.25, 0.75, 0.0]])

    def waves(x):
        parts = [x]
        for k in range(octaves):
            scaled = graph("Mul", x, graph.constant(2.0**k))
            parts += [graph("Sin", scaled), graph("Cos", scaled)]
        return parts

    def at(values, places, ranks):
        # [1, ranks, slow, fast] at [n, 2] of (fast, slow): [n, ranks]
        grid = graph.constant(places[None, None])
        found = graph("GridSample", values, grid, align_corners=1, mode="bilinear", padding_mode="border")
        return graph("Transpose", graph("Reshape", found, graph.constant([ranks, n], np.int64)), perm=[1, 0])

    def grid(name, ranks):
        random = lambda shape: RANDOM.uniform(-0.7, 0.7, shape).astype(np.float32)
        pairs = [(0, 1), (0, 2), (1, 2)]
        planes = [random([resolution[slow], resolution[fast], ranks]) for fast, slow in pairs]
        lines = [random([count, ranks]) for count in resolution]
        tensors[f"visnerf.{name}.planes"] = np.concatenate([plane.ravel() for plane in planes])
        tensors[f"visnerf.{name}.lines"] = np.concatenate([line.ravel() for line in lines])
        total = None
        for (fast, slow), plane in zip(pairs, planes):
            axis = 3 - fast - slow
            of_plane = at(graph.constant(plane.transpose(2, 0, 1)[None]), points[:, [fast, slow]], ranks)
            line = lines[axis].T[None, :, :, None]
            along = np.stack([np.zeros(n, np.float32), points[:, axis]], axis=1)
            product = graph("Mul", of_plane, at(graph.constant(line), along, ranks))
            total = product if total is None else graph("Add", total, product)
        vectors = graph("MatMul", mixture, weights(f"{name}.times", [knots, time_ranks], 0.7))
        vectors = graph("Expand", vectors, graph.constant([n, time_ranks], np.int64))
        basis = weights(f"{name}.basis", [ranks + time_ranks, features], 0.8)
        return graph("MatMul", graph("Concat", total, vectors, axis=1), basis)

    def mlp(name, x, outputs):
        inputs = (3 + features) * (1 + 2 * octaves)
        x = graph("Relu", weights.linear(x, f"{name}.first", inputs, width))
        x = graph("Relu", weights.linear(x, f"{name}.second", width, width))
        return weights.linear(x, f"{name}.output", width, outputs)

    # columns as ours: the vector with its waves, then the features with theirs
    see = lambda vectors, values: graph("Concat", *waves(graph.constant(vectors)), *waves(values), axis=1)
    density = mlp("density_mlp", see(points, grid("density", 2)), 1)
    density = graph("Softplus", graph("Sub", density, graph.constant(0.5)))
    colour = graph("Sigmoid", mlp("colour_mlp", see(directions, grid("appearance", 3)), 3))
    density, colour = graph.run([density, colour])
    tensors["visnerf.check.densities"], tensors["visnerf.check.colours"] = density.ravel(), colour


def main():
    tensors = {}
    coordnet(tensors)
    generator(tensors, training=True)
    generator(tensors, training=False)
    discriminator(tensors)
    visnerf(tensors)
    save_file({name: np.ascontiguousarray(value) for name, value in tensors.items()}, sys.argv[1])
    for name, value in sorted(tensors.items()):
        if ".check." in name:
            print(f"{name} {list(value.shape)} mean {value.mean():.4f} deviation {value.std():.4f}")


main()
