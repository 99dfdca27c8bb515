"""What planners, the shield and policies share: dynamics, plans and what they cost."""
