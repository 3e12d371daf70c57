"""Derivatives: functions of the IR that also compute how their results change with their inputs."""
