"""An example of plugins for clsim, one module for each kind."""
