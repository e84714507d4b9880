"""Face motion becomes servo angles: a regression per robot, in readable text. Knows no bus."""
