"""A study for tests that kill it: `python flying.py STORE PAUSE [processes]` flies 240 pendulums, or what is missing.

Ends with 0, or with 143 after the signal of which a batch system says that.
"""

import sys
import time

from dispersed import fly, sample

from plants.simulation import campaign

RUNS, BATCH = 240, 8


def fly_all(**options):
    return fly(campaign.draw(sample, RUNS, 5), batch=BATCH, workers=2, keep=(3,), **options)


if __name__ == "__main__":
    folder, pause = sys.argv[1], float(sys.argv[2])
    flown = fly_all(
        store=folder, resume=True, processes="processes" in sys.argv, on_batch=lambda done: time.sleep(pause)
    )
    print(f"{len(flown.index)} flown")
    sys.exit(0 if flown.complete else 143)
