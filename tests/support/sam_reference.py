#!/usr/bin/env python3
"""Writes tests/data/sam.safetensors: a small Segment Anything network with random weights and what it makes of an image.

Runs the published implementation (https://github.com/ChaoningZhang/MobileSAM, commit 34bbbfd, Apache-2.0) on PyTorch:

    pip install torch torchvision "timm<1.1" safetensors numpy
    git clone https://github.com/ChaoningZhang/MobileSAM
    PYTHONPATH=MobileSAM python tests/support/sam_reference.py tests/data/sam.safetensors

With --full PATH it writes instead the weights of the full-size network, with inputs and outputs, to PATH.
Weights stand under their published names, inputs and outputs under `check.*`.
"""

import sys
import time
import types

import numpy as np
import torch
from mobile_sam.modeling import MaskDecoder, PromptEncoder, Sam, TwoWayTransformer
from mobile_sam.modeling.common import LayerNorm2d
from mobile_sam.modeling.tiny_vit_sam import TinyViT
from mobile_sam.utils.amg import calculate_stability_score, build_point_grid, mask_to_rle_pytorch
from mobile_sam.utils.transforms import ResizeLongestSide
from safetensors.torch import save_file
from torchvision.ops.boxes import nms

SMALL = dict(
    size=64, dims=[8, 16, 16, 24], depths=[1, 1, 2, 1], heads=[1, 2, 4, 3], windows=[1, 3, 4, 2],
    mlp_ratio=2.0, expand=3.0, prompt=16, depth=2, decoder_heads=2, mlp=24, iou_hidden=12, gain=1.3,
)
FULL = dict(
    size=1024, dims=[64, 128, 160, 320], depths=[2, 2, 6, 2], heads=[2, 4, 5, 10], windows=[7, 7, 14, 7],
    mlp_ratio=4.0, expand=4.0, prompt=256, depth=2, decoder_heads=8, mlp=2048, iou_hidden=256, gain=0.7,
)

# of the weights; chosen among 24 for little amplification of rounding and many masks that pass
SEED = 22
# boxes of random masks overlap much
OVERLAP = 0.93


def build(c):
    encoder = TinyViT(
        img_size=c["size"], num_classes=1, embed_dims=c["dims"], depths=c["depths"], num_heads=c["heads"],
        window_sizes=c["windows"], mlp_ratio=c["mlp_ratio"], mbconv_expand_ratio=c["expand"], drop_path_rate=0.0,
    )
    # The published code fixes these three for the full size: the last merge's stride by its
    # channels, the neck's width, and the embedding's side.
    encoder.layers[2].downsample.conv2.c.stride = (1, 1)
    p, side = c["prompt"], c["size"] // 16
    encoder.neck = torch.nn.Sequential(
        torch.nn.Conv2d(c["dims"][-1], p, 1, bias=False), LayerNorm2d(p),
        torch.nn.Conv2d(p, p, 3, padding=1, bias=False), LayerNorm2d(p),
    )

    def forward(self, x):
        x = self.patch_embed(x)
        for layer in self.layers:
            x = layer(x)
        return self.neck(x.view(x.shape[0], side, side, -1).permute(0, 3, 1, 2))

    encoder.forward = types.MethodType(forward, encoder)
    return Sam(
        image_encoder=encoder,
        prompt_encoder=PromptEncoder(
            embed_dim=p, image_embedding_size=(side, side), input_image_size=(c["size"], c["size"]), mask_in_chans=16
        ),
        mask_decoder=MaskDecoder(
            num_multimask_outputs=3,
            transformer=TwoWayTransformer(
                depth=c["depth"], embedding_dim=p, mlp_dim=c["mlp"], num_heads=c["decoder_heads"]
            ),
            transformer_dim=p, iou_head_depth=3, iou_head_hidden_dim=c["iou_hidden"],
        ),
    )


def randomise(model, gain):
    """No parameter keeps a value that would hide a mistake."""
    g = torch.Generator().manual_seed(SEED)

    def normal(shape, scale):
        return torch.randn(shape, generator=g) * scale

    for name, t in model.state_dict().items():
        if not t.is_floating_point():
            continue
        if name.endswith("running_var"):
            value = 0.5 + torch.rand(t.shape, generator=g)
        elif name.endswith("running_mean") or name.endswith(".bias"):
            # large where a norm over few channels follows, which else amplifies rounding
            value = normal(t.shape, 1.5 if "upscaling.0" in name else 0.2)
        elif name.endswith("attention_biases"):
            value = normal(t.shape, 0.7)
        elif t.dim() == 1:
            value = 0.7 + 0.6 * torch.rand(t.shape, generator=g)
        elif t.dim() == 2 and ("embed" in name or "token" in name or "gaussian" in name):
            value = normal(t.shape, 1.0)
        else:
            fan_in = t[0].numel() if "upscaling" not in name else t.shape[0]
            value = normal(t.shape, gain / fan_in**0.5)
        t.copy_(value)


def noise(height, width, channels, seed):
    """Smooth stripes plus a little noise; RGB bytes."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:height, 0:width]
    waves = [np.sin(x / width * (3 + c) + y / height * (5 - c)) for c in range(channels)]
    image = np.stack(waves, -1) * 90 + 128 + rng.normal(0, 20, (height, width, channels))
    return image.clip(0, 255).astype(np.uint8)


@torch.no_grad()
def run(c, height, width):
    model = build(c)
    randomise(model, c["gain"])
    model.eval()  # also rebuilds the attention biases' table
    out = {}
    image = noise(height, width, 3, 1)
    out["image"] = torch.from_numpy(image.copy())
    transform = ResizeLongestSide(c["size"])
    resized = transform.apply_image(image)
    out["resized"] = torch.from_numpy(resized.copy())
    pixels = torch.from_numpy(resized.copy()).permute(2, 0, 1)[None]
    start = time.time()
    features = model.image_encoder(model.preprocess(pixels.float()))
    print(f"encoder {time.time() - start:.2f} s")
    out["embedding"] = features

    rng = np.random.default_rng(5)
    at = rng.uniform(0, 1, (3, 2, 2)) * [width, height]
    boxes = np.array([[0.1, 0.2, 0.7, 0.9], [0.3, 0.1, 0.5, 0.6], [0.0, 0.0, 1.0, 1.0]]) * [width, height, width, height]
    labels = np.array([[1, 0], [0, 1], [1, 1]])
    out["points"], out["labels"] = torch.from_numpy(at).float(), torch.from_numpy(labels).float()
    out["boxes"] = torch.from_numpy(boxes).float()
    points = torch.from_numpy(transform.apply_coords(out["points"].numpy(), (height, width)))
    corners = torch.from_numpy(transform.apply_boxes(out["boxes"].numpy(), (height, width)))
    labels = torch.from_numpy(labels)

    def decode(name, points, boxes, multimask):
        sparse, dense = model.prompt_encoder(points=points, boxes=boxes, masks=None)
        out[f"{name}.sparse"] = sparse
        start = time.time()
        logits, iou = model.mask_decoder(
            image_embeddings=features, image_pe=model.prompt_encoder.get_dense_pe(),
            sparse_prompt_embeddings=sparse, dense_prompt_embeddings=dense, multimask_output=multimask,
        )
        print(f"decoder {name} {time.time() - start:.2f} s")
        out[f"{name}.logits"], out[f"{name}.iou"] = logits, iou
        return logits, dense

    logits, dense = decode("points", (points, labels), None, True)
    out["dense"], out["cells"] = dense[:1], model.prompt_encoder.get_dense_pe()
    full = model.postprocess_masks(logits, resized.shape[:2], (height, width))
    out["points.full"] = full[0] if c is SMALL else full[:1, :1]
    out["points.stability"] = calculate_stability_score(full, 0.0, 1.0)
    decode("single", (points, labels), None, False)
    decode("both", (points[:, :1], labels[:, :1]), corners, True)
    decode("boxes", None, corners, True)

    # the automatic mode, as the published generator does it, with all candidates kept and looser limits
    grid = build_point_grid(3) * [width, height]
    grid = torch.from_numpy(transform.apply_coords(grid, (height, width)))
    logits, _ = decode("grid", (grid[:, None], torch.ones(9, 1, dtype=torch.int)), None, True)
    iou = out["grid.iou"].flatten()
    full = model.postprocess_masks(logits, resized.shape[:2], (height, width)).flatten(0, 1)
    stability = calculate_stability_score(full, 0.0, 0.1)
    # limits halfway between two values, so that rounding cannot decide
    between = lambda values, part: values.sort().values[int(part * len(values)) - 1 :][:2].mean()
    iou_limit = between(iou, 0.3)
    stability_limit = between(stability[iou > iou_limit], 0.3)
    keep = (iou > iou_limit) & (stability >= stability_limit)
    index = keep.nonzero()[:, 0]
    set_ = full[index] > 0
    edges = []
    for m in set_:
        y, x = m.nonzero(as_tuple=True)
        edges.append([x.min(), y.min(), x.max(), y.max()] if len(x) else [0, 0, 0, 0])
    order = nms(torch.tensor(edges).float(), iou[index], OVERLAP)
    print(f"automatic: {len(iou)} candidates, {len(index)} pass, {len(order)} after suppression")
    out["automatic.limits"] = torch.stack([iou_limit, stability_limit, torch.tensor(OVERLAP)])
    out["automatic.index"] = index[order].float()
    out["automatic.stability"] = stability[index[order]]
    counts = [r["counts"] for r in mask_to_rle_pytorch(set_[order])]
    out["automatic.counts"] = torch.tensor([len(r) for r in counts] + sum(counts, [])).float()
    if c is SMALL:
        for key in ("grid.logits", "grid.sparse"):
            del out[key]
    else:
        for key in ("points", "single", "both", "boxes", "grid"):
            out[f"{key}.logits"] = out[f"{key}.logits"][:2]

    # a strong reduction, by itself
    big = noise(41, 23, 3, 3)
    out["shrink.from"] = torch.from_numpy(big.copy())
    out["shrink.to"] = torch.from_numpy(ResizeLongestSide(16).apply_image(big).copy())

    unused = ("mask_downscaling", "norm_head", "image_encoder.head", "num_batches_tracked")
    weights = {k: v for k, v in model.state_dict().items() if c is FULL or not any(u in k for u in unused)}
    return weights, out


def main():
    full = sys.argv[1] == "--full"
    weights, out = run(FULL, 600, 800) if full else run(SMALL, 37, 50)
    tensors = {k: v.float().contiguous() if v.is_floating_point() else v for k, v in weights.items()}
    tensors |= {f"check.{k}": v.float().contiguous() if v.is_floating_point() else v for k, v in out.items()}
    for k, v in out.items():
        if v.is_floating_point():
            print(f"{k}: {list(v.shape)} {v.min():.3f} .. {v.max():.3f}")
    save_file(tensors, sys.argv[-1])


main()
