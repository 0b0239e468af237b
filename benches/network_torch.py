"""Times one training step of the network that reconstructs in PyTorch and in this crate, and prints both side by side.

    python benches/network_torch.py [rounds [cargo profile]]

Needs torch and cargo. A step of PyTorch is forward, backward and Muon with AdamW for a batch of 4 images of 96 x 96 px with 5
channels. A step of this crate also draws objects and noise and computes the linear estimates. The two take turns on the same
processor; the least time of all rounds is printed, since other work on the machine can only lengthen a step.
"""

import os
import sys
import time

import torch
from torch import nn
from torch.nn.functional import pixel_shuffle, pixel_unshuffle, silu

from crate_times import least_times

BATCH, SIDE, INPUTS = 4, 96, 5
CHANNELS, BLOCKS = (32, 64, 96), (1, 2, 2, 1, 1)
SAMPLES = ("network/step", "network/products", "network/products without filtering")


def conv3(inputs, outputs):
    return nn.Conv2d(inputs, outputs, 3, padding=1)


class Block(nn.Module):
    def __init__(self, channels):
        super().__init__()
        self.first, self.second = conv3(channels, channels), conv3(channels, channels)

    def forward(self, image):
        return image + self.second(silu(self.first(silu(image))))


class Network(nn.Module):
    """The residual U-net: half, quarter and eighth of the resolution and back, sums as skips."""

    def __init__(self):
        super().__init__()
        half, quarter, eighth = CHANNELS
        levels = (half, quarter, eighth, quarter, half)
        self.stem = conv3(4 * INPUTS, half)
        self.stages = nn.ModuleList(
            nn.Sequential(*(Block(channels) for _ in range(blocks))) for channels, blocks in zip(levels, BLOCKS)
        )
        self.down = nn.ModuleList((nn.Conv2d(half, quarter, 2, stride=2), nn.Conv2d(quarter, eighth, 2, stride=2)))
        self.up = nn.ModuleList((nn.Conv2d(eighth, 4 * quarter, 1), nn.Conv2d(quarter, 4 * half, 1)))
        self.out = conv3(half, 4)

    def forward(self, image):
        half = self.stages[0](self.stem(pixel_unshuffle(image, 2)))
        quarter = self.stages[1](self.down[0](half))
        eighth = self.stages[2](self.down[1](quarter))
        quarter = self.stages[3](quarter + pixel_shuffle(self.up[0](eighth), 2))
        half = self.stages[4](half + pixel_shuffle(self.up[1](quarter), 2))
        return pixel_shuffle(self.out(silu(half)), 2)


class Muon:
    """Nesterov momentum whose singular values five Newton-Schulz iterations make nearly equal."""

    def __init__(self, kernels, rate=6e-3, momentum=0.9, decay=0.1):
        self.kernels, self.rate, self.momentum, self.decay = kernels, rate, momentum, decay
        self.means = [torch.zeros_like(kernel) for kernel in kernels]

    @torch.no_grad()
    def step(self):
        for kernel, mean in zip(self.kernels, self.means):
            mean.mul_(self.momentum).add_(kernel.grad)
            matrix = (kernel.grad + self.momentum * mean).reshape(len(kernel), -1)
            is_tall = matrix.shape[0] > matrix.shape[1]
            matrix = matrix.T if is_tall else matrix
            matrix = matrix / (matrix.norm() + 1e-7)
            for _ in range(5):
                square = matrix @ matrix.T
                matrix = 3.4445 * matrix + (2.0315 * square @ square - 4.775 * square) @ matrix
            change = (matrix.T if is_tall else matrix).reshape(kernel.shape)
            kernel.mul_(1 - self.rate * self.decay)
            kernel.add_(change, alpha=-0.2 * self.rate * max(matrix.shape) ** 0.5)


def torch_step(layout):
    """A training step, with images in the memory format `layout`."""
    torch.manual_seed(0)
    network = Network().to(memory_format=layout)
    images = torch.rand(BATCH, INPUTS, SIDE, SIDE).to(memory_format=layout)
    truth = torch.rand(BATCH, 1, SIDE, SIDE)
    is_inner = lambda name, weights: weights.ndim > 1 and not name.startswith(("stem", "out"))
    named = list(network.named_parameters())
    muon = Muon([weights for name, weights in named if is_inner(name, weights)])
    adam = torch.optim.AdamW([weights for name, weights in named if not is_inner(name, weights)], lr=1.5e-3)

    def step():
        network.zero_grad()
        (network(images) - truth).square().mean().backward()
        nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        adam.step()
        muon.step()

    return step, sum(weights.numel() for _, weights in named)


def least_time(step, seconds=8.0):
    least, end = float("inf"), time.perf_counter() + seconds
    while time.perf_counter() < end:
        start = time.perf_counter()
        step()
        least = min(least, time.perf_counter() - start)
    return least


def main():
    rounds = int(sys.argv[1]) if len(sys.argv) > 1 else 2
    profile = sys.argv[2] if len(sys.argv) > 2 else "bench"
    torch.set_num_threads(os.cpu_count())
    print(f"{os.cpu_count()} threads, torch {torch.__version__}, {rounds} rounds, profile {profile}, least time per step")
    steps, counts = zip(*(torch_step(layout) for layout in (torch.contiguous_format, torch.channels_last)))
    rows = []
    for _ in range(rounds):
        rows.append((*map(least_time, steps), *least_times(profile, "network", SAMPLES)))
    planes, channels_last, ours, products, plain = map(min, zip(*rows))
    theirs = min(planes, channels_last)
    print(
        f"torch {planes * 1e3:.1f} ms, channels last {channels_last * 1e3:.1f} ms ({counts[0]} weights); this crate "
        f"{ours * 1e3:.1f} ms, ratio {ours / theirs:.3f}; products alone {products * 1e3:.1f} ms, "
        f"{products / ours:.0%} of their rate; without filtering {plain * 1e3:.1f} ms, {plain / ours:.0%}"
    )


if __name__ == "__main__":
    main()
