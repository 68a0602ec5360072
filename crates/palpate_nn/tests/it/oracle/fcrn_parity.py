"""Reference values of the FCRN from PyTorch: writes fcrn_parity.safetensors beside this file.

Run: python fcrn_parity.py        (written with PyTorch 2.15, CPU)

The network is built here from its table of layers, at width 2, in double precision; all numbers are then stored as f32
(the images as f16, in which they are exact). Weights, norms and running statistics are random, none is a default.
"""

import json
import pathlib
import struct

import torch
from torch import nn
from torch.nn import functional as F

WIDTH = 2
torch.manual_seed(3)
torch.set_default_dtype(torch.float64)


class ConvNorm(nn.Module):
    def __init__(self, inputs, outputs, kernel, stride=1):
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, bias=False)
        self.norm = nn.BatchNorm2d(outputs)

    def forward(self, x):
        return self.norm(self.conv(x))


class Bottleneck(nn.Module):
    def __init__(self, inputs, width, stride):
        super().__init__()
        self.reduce = ConvNorm(inputs, width, 1)
        self.middle = ConvNorm(width, width, 3, stride)
        self.expand = ConvNorm(width, 4 * width, 1)
        self.shortcut = ConvNorm(inputs, 4 * width, 1, stride) if stride > 1 or inputs != 4 * width else None

    def forward(self, x):
        short = x if self.shortcut is None else self.shortcut(x)
        return F.relu(self.expand(F.relu(self.middle(F.relu(self.reduce(x))))) + short)


class Encoder(nn.Module):
    def __init__(self, w):
        super().__init__()
        self.stem = ConvNorm(3, w, 7, 2)
        inputs = w
        for group, (blocks, width, stride) in enumerate([(3, w, 1), (4, 2 * w, 2), (6, 4 * w, 2), (3, 8 * w, 2)]):
            layers = []
            for i in range(blocks):
                layers.append(Bottleneck(inputs, width, stride if i == 0 else 1))
                inputs = 4 * width
            setattr(self, f"layer{group + 1}", nn.Sequential(*layers))

    def forward(self, x):
        x = F.max_pool2d(F.relu(self.stem(x)), 3, 2, 1)
        return self.layer4(self.layer3(self.layer2(self.layer1(x))))


class Unpool(nn.Module):
    def __init__(self, inputs, outputs):
        super().__init__()
        self.conv3x3 = nn.Conv2d(inputs, outputs, (3, 3))
        self.conv2x3 = nn.Conv2d(inputs, outputs, (2, 3))
        self.conv3x2 = nn.Conv2d(inputs, outputs, (3, 2))
        self.conv2x2 = nn.Conv2d(inputs, outputs, (2, 2))

    def forward(self, x):
        # F.pad takes left, right, top, bottom.
        n, _, h, w = x.shape
        a = self.conv3x3(F.pad(x, (1, 1, 1, 1)))
        out = x.new_zeros(n, a.shape[1], 2 * h, 2 * w)
        out[:, :, 0::2, 0::2] = a
        out[:, :, 0::2, 1::2] = self.conv2x3(F.pad(x, (1, 1, 1, 0)))
        out[:, :, 1::2, 0::2] = self.conv3x2(F.pad(x, (1, 0, 1, 1)))
        out[:, :, 1::2, 1::2] = self.conv2x2(F.pad(x, (1, 0, 1, 0)))
        return out


class UpProjection(nn.Module):
    def __init__(self, inputs, outputs):
        super().__init__()
        self.main_unpool = Unpool(inputs, outputs)
        self.main_norm1 = nn.BatchNorm2d(outputs)
        self.main_conv = nn.Conv2d(outputs, outputs, 3, padding=1)
        self.main_norm2 = nn.BatchNorm2d(outputs)
        self.short_unpool = Unpool(inputs, outputs)
        self.short_norm = nn.BatchNorm2d(outputs)

    def forward(self, x):
        main = self.main_norm2(self.main_conv(F.relu(self.main_norm1(self.main_unpool(x)))))
        return F.relu(main + self.short_norm(self.short_unpool(x)))


class Fcrn(nn.Module):
    def __init__(self, w):
        super().__init__()
        self.encoder = Encoder(w)
        self.bridge = ConvNorm(32 * w, 16 * w, 1)
        self.up = nn.ModuleList([UpProjection(k * w, k * w // 2) for k in (16, 8, 4, 2)])
        self.last = nn.Conv2d(w, 1, 3, padding=1)

    def forward(self, x, head):
        size = x.shape[2:]
        x = self.bridge(self.encoder(x))
        for up in self.up:
            x = up(x)
        x = self.last(x)
        x = F.relu(x) if head == "height" else torch.sigmoid(x)
        x = F.interpolate(x, size=size, mode="bilinear", align_corners=False)
        if head == "height":
            line = torch.exp(-torch.tensor([-1.0, 0.0, 1.0]) ** 2 / (2 * 0.8**2))
            line = line / line.sum()
            x = F.conv2d(F.pad(x, (1, 1, 1, 1), mode="reflect"), torch.outer(line, line)[None, None])
        return x


def name(key):
    """Norms call their parameters gamma and beta here."""
    parent, leaf = key.rsplit(".", 1)
    if "norm" in parent.rsplit(".", 1)[-1]:
        leaf = {"weight": "gamma", "bias": "beta"}.get(leaf, leaf)
    return f"{parent}.{leaf}"


def state(net):
    return {k: v.detach().clone() for k, v in net.state_dict().items() if not k.endswith("num_batches_tracked")}


net = Fcrn(WIDTH)
with torch.no_grad():
    for key, value in state(net).items():
        leaf = key.rsplit(".", 1)[1]
        if value.ndim == 4:
            new = torch.randn_like(value) * (2.0 / (value[0].numel())) ** 0.5
        elif leaf == "running_var" or "gamma" in name(key):
            new = 0.5 + torch.rand_like(value)
        else:
            new = 0.2 * torch.randn_like(value)
        net.state_dict()[key].copy_(new.float())
    net.last.bias.fill_(0.25)
    # Running statistics near those of real batches: otherwise the outputs in evaluation reach thousands.
    norms = [m for m in net.modules() if isinstance(m, nn.BatchNorm2d)]
    for m in norms:
        m.momentum = 1.0
    net.train()(torch.randn(8, 3, 64, 96), "mask")
    for m in norms:
        m.momentum = 0.1
        m.running_mean.copy_((m.running_mean + 0.1 * torch.randn_like(m.running_mean)).float())
        m.running_var.copy_((m.running_var * (0.8 + 0.4 * torch.rand_like(m.running_var))).float())

out = {f"weights.{name(k)}": v for k, v in state(net).items()}
before = state(net)
image = (torch.randn(2, 3, 64, 96) * 16).round().clamp(-64, 63) / 16
truth = {"height": 2 * torch.rand(2, 1, 64, 96).float().double(), "mask": (torch.rand(2, 1, 64, 96) > 0.6).double()}
out["image"] = image
out["truth.height"], out["truth.mask"] = truth["height"], truth["mask"]

for head in ("height", "mask"):
    net.load_state_dict(before, strict=False)
    out[f"{head}.eval"] = net.eval()(image, head).detach()
    counts, hooks = {}, []
    for key, module in net.named_modules():
        if isinstance(module, nn.BatchNorm2d):
            def hook(module, inputs, key=key):
                counts[key] = inputs[0].numel() / inputs[0].shape[1]
            hooks.append(module.register_forward_pre_hook(hook))
    net.train().zero_grad()
    predicted = net(image, head)
    loss = ((predicted - truth[head]) ** 2).mean().sqrt()
    loss.backward()
    out[f"{head}.train"] = predicted.detach()
    out[f"{head}.loss"] = loss.detach().reshape(1)
    for key, value in net.named_parameters():
        if head == "height" or key in ("encoder.stem.conv.weight", "up.3.short_norm.weight", "last.weight"):
            out[f"{head}.gradient.{name(key)}"] = value.grad
    if head == "height":
        for key, n in counts.items():
            after = net.state_dict()
            out[f"after.{key}.running_mean"] = after[f"{key}.running_mean"]
            # PyTorch averages the unbiased variance; without the factor n / (n - 1) it is the biased one.
            old = before[f"{key}.running_var"]
            out[f"after.{key}.running_var"] = 0.9 * old + (after[f"{key}.running_var"] - 0.9 * old) * (n - 1) / n
    for h in hooks:
        h.remove()

header, data = {"__metadata__": {"torch": torch.__version__.split("+")[0]}}, b""
for key in sorted(out):
    kind = torch.float16 if key in ("image", "truth.mask") else torch.float32
    raw = out[key].to(kind).contiguous().numpy().tobytes()
    header[key] = {
        "dtype": "F16" if kind == torch.float16 else "F32",
        "shape": list(out[key].shape),
        "data_offsets": [len(data), len(data) + len(raw)],
    }
    data += raw
text = json.dumps(header).encode()
text += b" " * (-len(text) % 8)
path = pathlib.Path(__file__).with_name("fcrn_parity.safetensors")
path.write_bytes(struct.pack("<Q", len(text)) + text + data)
print(path, path.stat().st_size, "bytes; trainable:", sum(p.numel() for p in net.parameters()))
