"""The same task as a Slurm array: one element solves so many flights, one after the other."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Sequence

from .lake import Flight

SCRIPT = """\
#!/bin/bash
#SBATCH --job-name=wingd-{solve}
#SBATCH --array=0-{last}
#SBATCH --cpus-per-task={jobs}
#SBATCH --requeue
#SBATCH --output={folder}/%a.log
# Submit it with: sbatch --export=ALL {folder}/array.sh   (the AWS_* variables go along)
# Lost elements are requeued; submitting it again solves what is missing and nothing else.
set -u
first=$((SLURM_ARRAY_TASK_ID * {chunk} + 1)) failed=0
while read -r flight; do
    {fleet} task --lake {lake} --solve {solve} --wingd {wingd} --jobs {jobs} \\
        --work "${{SLURM_TMPDIR:-${{TMPDIR:-/tmp}}}}/wingd-$SLURM_ARRAY_TASK_ID" --flight "$flight" </dev/null || failed=1
done < <(sed -n "$first,$((first + {chunk} - 1))p" {folder}/flights.txt)
exit $failed
"""


def write(folder: Path, url: str, solve: str, flights: Sequence[Flight], wingd: str, fleet: str, chunk: int, jobs: int):
    """Writes flights.txt and array.sh; returns the script and the number of its elements.

    Slurm's MaxArraySize is 1001 where it was not raised: 10,000 flights take a chunk of 10.
    """
    folder = folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "flights.txt").write_text("".join(f"{flight}\n" for flight in flights))
    elements = max(1, -(-len(flights) // chunk))
    quoted = {"folder": folder, "lake": url, "wingd": wingd, "fleet": fleet}
    quoted = {name: shlex.quote(str(value)) for name, value in quoted.items()}
    text = SCRIPT.format(solve=solve, last=elements - 1, chunk=chunk, jobs=jobs, **quoted)
    script = folder / "array.sh"
    script.write_text(text)
    return script, elements
