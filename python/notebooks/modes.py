# %% [markdown]
# # Modes of the wing
#
# Frequencies, damping and shapes with standard deviations, from deflections at a regular rate: `wingd.modes.rows` reads exported live results.
# Here two modes of known frequency, excited by white noise, stand for them.

# %%
import numpy as np

import wingd
from wingd import modes

rate, count = 20.0, 4_000
rng = np.random.default_rng(3)
places = np.linspace(0.2, 1.0, 6)
shapes = np.stack([places**2, places**2 * (places - 0.75) * 4])
deflections = rng.normal(size=(count, len(places))) * 2e-4
for (hz, damping), shape in zip([(1.3, 0.03), (4.1, 0.03)], shapes, strict=True):
    # A damped oscillator, sampled exactly.
    decay, turn = np.exp(-2 * np.pi * hz * damping / rate), 2 * np.pi * hz * np.sqrt(1 - damping**2) / rate
    state, force = np.zeros(count), rng.normal(size=count) * 0.01
    for k in range(2, count):
        state[k] = 2 * decay * np.cos(turn) * state[k - 1] - decay**2 * state[k - 2] + force[k]
    deflections += state[:, None] * shape

# %%
found = modes.identify(deflections, rate_hz=rate, lowest_hz=0.5, count=2)
for mode in found:
    print(f"{mode.hz:.3f} ± {mode.sigma_hz:.3f} Hz, damping {mode.damping:.3f} ± {mode.sigma_damping:.3f}")
assert [round(mode.hz) for mode in found] == [1, 4]
assert all(abs(mode.hz - truth) < 4 * mode.sigma_hz for mode, truth in zip(found, (1.3, 4.1), strict=True))

# %%
import matplotlib.pyplot as plt  # noqa: E402

plt.style.use(wingd.plot.STYLE)
figure, axes = plt.subplots()
for mode in found:
    axes.errorbar(places, mode.shape, mode.sigma_shape, marker="o", label=f"{mode.hz:.2f} Hz")
axes.set_xlabel("fraction of the length")
axes.set_ylabel("mode shape, 1 at the outermost point")
axes.legend()
figure.savefig("modes.png")
