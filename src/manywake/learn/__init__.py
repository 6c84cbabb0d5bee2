"""Many episodes: policy, rollout, engines, collection, PPO, runs and evaluation."""
