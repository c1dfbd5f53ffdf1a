"""How all pictures show people and the floor: colours, image, plan view."""
