import pinimpact

robot = pinimpact.load_robot("panda")
table = pinimpact.Plane(point=(0, 0, 0.5), normal=(0, 0, 1))
hand = pinimpact.Contact("panda_hand_tcp", table, friction=0.3, restitution=0.5)
q = pinimpact.place_in_contact(robot.model, robot.data, robot.q0, hand)  # the hand on the table, close to q0
v = [0.4, 2.0, 0.4, -0.8, 0.25, 1.0, 0, 0, 0]  # joint velocities as the hand touches the table
hit = pinimpact.impact(robot.model, robot.data, q, v, hand)  # hit.v: the joint velocities after
for segment in hit.solution.segments:
    print(f"{segment.mode} in {segment.phase}, normal impulse {segment.start:.3f} to {segment.end:.3f} N s")
print(f"impulse on the robot {hit.impulse_world.round(3)} N s, its work {hit.solution.work.total:.3f} J")
