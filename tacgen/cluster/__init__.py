"""Batch jobs through submitit: submitting shards or a long command, and their states."""

from tacgen.cluster.states import Status, job_states, jobs_text, status, status_text
from tacgen.cluster.submission import (
    Submitted,
    require_command,
    submit,
    submit_command,
    wait_for,
    wait_for_command,
)

__all__ = [
    "Status",
    "Submitted",
    "job_states",
    "jobs_text",
    "require_command",
    "status",
    "status_text",
    "submit",
    "submit_command",
    "wait_for",
    "wait_for_command",
]
