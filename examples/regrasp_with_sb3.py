"""Learns when to lift and how to regrasp: `python examples/regrasp_with_sb3.py [STEPS]`.

Needs `pip install 'tacgen[gym]' stable-baselines3`.
"""

import sys

from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import SubprocVecEnv

from tacgen.collection.recipe import Recipe
from tacgen.envs import Normalized

recipe = Recipe.model_validate(
    {
        "name": "regrasp",
        "objects": ["rubiks_cube", "tomato_soup_can"],
        "sensor": "digit",
        "robot": {"tactile_pads": "both"},
        "dataset": {"force_field": [6, 8]},
        "randomize": {"center_of_mass_mm": 8.0, "friction_relative": 0.3},
    }
)
options = {"recipe": recipe, "image_px": (64, 48), "regrasp_cost": 0.1}

if __name__ == "__main__":  # each environment is a process of its own
    steps = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000
    environments = make_vec_env(
        "tacgen/Regrasp-v0",
        n_envs=4,
        seed=0,
        env_kwargs=options,
        wrapper_class=Normalized,
        vec_env_cls=SubprocVecEnv,
    )
    policy = PPO("MultiInputPolicy", environments, n_steps=64, batch_size=64, seed=0)
    for learned in (0, steps):
        if learned:
            policy.learn(learned)
        mean, spread = evaluate_policy(policy, environments, n_eval_episodes=20)
        print(f"after {policy.num_timesteps} steps: reward {mean:.2f} ± {spread:.2f}")  # noqa: T201
    policy.save("regrasp_policy")
    environments.close()
