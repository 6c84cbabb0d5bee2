"""Many episodes: policy, rollout, engines, collection, PPO, runs and evaluation."""

import os

# Before torch is loaded: its threads should sleep while they wait for each other. As they come they spin, and where
# another process wants a core, an update then takes ten times as long (docs/performance.md).
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
