"""MiniGrid and BabyAI in pure JAX: same ids, dynamics, observations, missions and rewards."""
