"""The learner alone on the tasks of others, through `async_dmrac.Learner` and no private name."""
