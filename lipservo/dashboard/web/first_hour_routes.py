"""`/api/first-hour`: routes of the page that leads through a new face's setup."""

import asyncio
from typing import Any

from fastapi import APIRouter

from lipservo.dashboard.first_hour.first_hour import FirstHour
from lipservo.dashboard.web.api_models import (
    EndBody,
    NameBody,
    OrderBody,
    PortBody,
    StepBody,
    TurnBody,
    WireBody,
    WriteBody,
)

JsonObject = dict[str, Any]


def first_hour_routes(hour: FirstHour) -> APIRouter:
    """Return the routes; each applies one request to `hour` and answers with its whole state."""
    routes = APIRouter(prefix="/api/first-hour")

    @routes.get("")
    async def state() -> JsonObject:
        """Everything that the page shows. Servos are held for a person only while it is polled."""
        return await asyncio.to_thread(hour.state)

    @routes.post("/port")
    async def port(body: PortBody) -> JsonObject:
        """Choose where the servos are; those that answer are found at once."""
        await asyncio.to_thread(hour.choose_port, body.port, body.kind, simulated=body.simulated)
        return await state()

    @routes.post("/name")
    async def name(body: NameBody) -> JsonObject:
        """Name a servo that was found."""
        named = (body.id, body.name, body.positive, body.part)
        await asyncio.to_thread(hour.name_servo, *named, same=body.same)
        return await state()

    @routes.post("/wire")
    async def wire(body: WireBody) -> JsonObject:
        """Add a hobby servo by its wiring, or remove it by its name."""
        await asyncio.to_thread(hour.change_wiring, body.channel)
        return await state()

    @routes.post("/face")
    async def face(body: WriteBody) -> JsonObject:
        """Write the face's YAML."""
        await asyncio.to_thread(hour.write_face, body.board)
        return await state()

    @routes.post("/start")
    async def start(body: StepBody) -> JsonObject:
        """Begin a step on the servos; they may move."""
        options = body.model_dump(exclude={"step"}, exclude_none=True)
        await asyncio.to_thread(lambda: hour.start(body.step, **options))
        return await state()

    @routes.post("/order")
    async def order(body: OrderBody) -> JsonObject:
        """Send an order to the step that runs."""
        await asyncio.to_thread(hour.send_order, body.model_dump(exclude_none=True))
        return await state()

    @routes.post("/end")
    async def end() -> JsonObject:
        """End the step that runs: the face goes to rest, then torque goes off."""
        hour.end_step()
        return await state()

    @routes.post("/limit")
    async def limit(body: EndBody) -> JsonObject:
        """Set min, neutral or max of a limp joint where it is held now."""
        await asyncio.to_thread(hour.store_limit, body.servo, body.end)
        return await state()

    @routes.post("/limits")
    async def limits() -> JsonObject:
        """Write the limits that were set into the YAML and into the servos."""
        await asyncio.to_thread(hour.write_limits)
        return await state()

    @routes.post("/turn")
    async def turn(body: TurnBody) -> JsonObject:
        """Turn a simulated servo as a hand would."""
        await asyncio.to_thread(hour.turn_simulated, body.servo, body.by_deg)
        return await state()

    return routes
