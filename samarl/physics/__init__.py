"""Cases of `mrsan` in the physics engine MuJoCo: `pip install 'samarl[physics]'`."""
