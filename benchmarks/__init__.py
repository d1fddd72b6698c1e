"""Throughput, against peers in the same run; each benchmark prints JSON lines.

- `python -m benchmarks.env_throughput`: worlds stepped by random actions.
- `python -m benchmarks.train_throughput`: whole training.
"""
