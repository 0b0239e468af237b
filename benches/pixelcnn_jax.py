"""Times one training step of the published PixelCNN in JAX and in this crate, and prints both side by side.

    python benches/pixelcnn_jax.py [rounds [cargo profile]]

Needs jax, flax and optax, and cargo. A step is forward, backward and Adam for a batch of 64 patches of 16x16 or 32x32 px,
64 channels, 40 components. The two take turns on the same processor; the least time of all rounds is printed, since other
work on the machine can only lengthen a step.
"""

import os
import sys
import time

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy
import optax
from crate_times import least_times

BATCH, CHANNELS, COMPONENTS = 64, 64, 40
DILATIONS = (1, 2, 1, 4, 1, 2, 1)
SIDES = (16, 32)
NAMES = ("step", "products alone", "products without filtering")


class MaskedConv(nn.Module):
    """A convolution whose kernel is zero where `open`, rows of 0 and 1, says so."""

    features: int
    open: tuple
    dilation: int

    @nn.compact
    def __call__(self, image):
        size = numpy.shape(self.open)
        mask = numpy.array(self.open, dtype=numpy.float32)[:, :, None, None]
        mask = numpy.broadcast_to(mask, (*size, image.shape[-1], self.features))
        return nn.Conv(self.features, size, kernel_dilation=self.dilation, mask=mask)(image)


def vertical(features, dilation, own_row):
    """Sees the rows above, and the own row from the second layer on."""
    open = ((1, 1, 1), (own_row,) * 3, (0, 0, 0))
    return MaskedConv(features, open, dilation)


def horizontal(features, dilation, own_pixel):
    """Sees the pixel to the left, and the own one from the second layer on."""
    return MaskedConv(features, ((1, own_pixel, 0),), dilation)


def gated(features):
    a, b = jnp.split(features, 2, axis=-1)
    return jnp.tanh(a) * nn.sigmoid(b)


class PixelCnn(nn.Module):
    low: float
    high: float
    mean: float
    deviation: float

    @nn.compact
    def __call__(self, photons):
        image = ((photons - self.mean) / self.deviation)[..., None]
        v = vertical(CHANNELS, 1, own_row=0)(image)
        h = horizontal(CHANNELS, 1, own_pixel=0)(image)
        for dilation in DILATIONS:
            features = vertical(2 * CHANNELS, dilation, own_row=1)(v)
            v = gated(features)
            from_left = horizontal(2 * CHANNELS, dilation, own_pixel=1)(h)
            h = h + nn.Conv(CHANNELS, (1, 1))(gated(from_left + nn.Conv(2 * CHANNELS, (1, 1))(features)))
        out = nn.Conv(CHANNELS, (1, 1))(nn.elu(h))
        anywhere = lambda key, shape, dtype=jnp.float32: jax.random.uniform(key, shape, dtype, self.low, self.high)
        means = jnp.clip(nn.Dense(COMPONENTS, bias_init=anywhere)(out), self.low, self.high)
        widths = jnp.clip(nn.softplus(nn.Dense(COMPONENTS)(out)), 1.0, self.deviation)
        logits = nn.log_softmax(nn.Dense(COMPONENTS)(out))
        z = (photons[..., None] - means) / widths
        logs = logits - 0.5 * z**2 - jnp.log(widths) - 0.5 * jnp.log(2 * jnp.pi)
        return -jnp.mean(jax.scipy.special.logsumexp(logs, axis=-1))


def jax_step(side):
    """A compiled step and its first state."""
    counts = numpy.arange(BATCH * side * side).reshape(BATCH, side, side)
    photons = jnp.asarray((counts * 31 % 97) + 0.5, dtype=jnp.float32)
    model = PixelCnn(0.5, 96.5, float(photons.mean()), float(photons.std()))
    weights = model.init(jax.random.PRNGKey(0), photons[:1])
    adam = optax.adam(1e-3)

    def step(weights, moments):
        loss, gradient = jax.value_and_grad(model.apply)(weights, photons)
        change, moments = adam.update(gradient, moments)
        return optax.apply_updates(weights, change), moments, loss

    # The weights of the last step are not needed any more: their memory is used again.
    return jax.jit(step, donate_argnums=(0, 1)), weights, adam.init(weights)


def jax_seconds(step, state, seconds=8.0):
    """Least time of a step, and the state after it."""
    least, end = float("inf"), time.perf_counter() + seconds
    while time.perf_counter() < end:
        start = time.perf_counter()
        *state, loss = step(*state)
        loss.block_until_ready()
        least = min(least, time.perf_counter() - start)
    return least, state


def main():
    rounds = int(sys.argv[1]) if len(sys.argv) > 1 else 2
    profile = sys.argv[2] if len(sys.argv) > 2 else "bench"
    print(f"{os.cpu_count()} threads, jax {jax.__version__}, {rounds} rounds, profile {profile}, least time per step")
    for side in SIDES:
        step, *state = jax_step(side)
        *state, loss = step(*state)
        loss.block_until_ready()
        weights = sum(leaf.size for leaf in jax.tree_util.tree_leaves(state[0]))
        samples = [f"pixelcnn/{name}/{side}" for name in NAMES]
        rows = []
        for _ in range(rounds):
            seconds, state = jax_seconds(step, state)
            rows.append((seconds, *least_times(profile, "pixelcnn", samples, f"/{side}$")))
        theirs, ours, products, plain = map(min, zip(*rows))
        print(
            f"{side}x{side}: jax {theirs * 1e3:.0f} ms ({weights} weights), this crate {ours * 1e3:.0f} ms, "
            f"ratio {ours / theirs:.3f}; products alone {products * 1e3:.0f} ms, {products / ours:.0%} of their rate; "
            f"without filtering {plain * 1e3:.0f} ms, {plain / ours:.0%}"
        )


if __name__ == "__main__":
    main()
