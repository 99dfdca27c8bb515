"""What robots perceive: people and robots in view, and the sensors that `Scenario.sensors` adds."""
