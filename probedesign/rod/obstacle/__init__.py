"""A rod pressed against a fixed point or straight edge without friction."""

from probedesign.rod.obstacle.press import ObstacleContact, press_against_line, press_against_point

__all__ = ["ObstacleContact", "press_against_line", "press_against_point"]
