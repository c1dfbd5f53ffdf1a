"""Drawing of people and the floor in all pictures: colours, image, plan view."""
