"""Times of this crate's benches, for scripts that compare them with another program."""

import json
import pathlib
import subprocess

ROOT = pathlib.Path(__file__).resolve().parent.parent


def least_times(profile, bench, samples, *filters):
    """Seconds of an iteration, the least of criterion's samples, for each of `samples`: folders such as `pixelcnn/step/16`.

    `profile` is that of cargo, such as `bench`. Only benchmarks that match `filters` run.
    """
    cargo = lambda *arguments: subprocess.run(["cargo", *arguments], cwd=ROOT, check=True, capture_output=True).stdout
    target = json.loads(cargo("metadata", "--no-deps", "--format-version", "1"))["target_directory"]
    # Plots need fonts, and nobody looks at them.
    cargo("bench", "--profile", profile, "--bench", bench, "--", "--noplot", *filters)
    least = []
    for folder in samples:
        sample = json.loads((pathlib.Path(target) / "criterion" / folder / "new/sample.json").read_text())
        least.append(min(time / count for time, count in zip(sample["times"], sample["iters"])) * 1e-9)
    return least
