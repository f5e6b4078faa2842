"""Formats of robot learning and logging: LeRobot, MCAP."""
