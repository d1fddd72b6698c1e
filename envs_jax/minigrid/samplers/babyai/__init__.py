"""The distributions of BabyAI's levels, one module a family."""
