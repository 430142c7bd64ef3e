//! The conversation with a host: which of its requests is a new one, and the response to the last one.
//!
//! A request whose response was lost comes again under its number, and gets the same again; it is not carried out twice. One
//! that was overtaken by another is not carried out any more: its host has given it up.

use ihd_shared::wire::number::Number;

use crate::link::response::Response;

/// The last request, and its response once there is one.
#[derive(Default)]
pub struct Conversation {
    last: Number,
    response: Option<Response>,
}

/// Place of a request in the conversation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RequestOrder {
    /// A new one.
    New,
    /// The last one once more.
    Again,
    /// One before the last.
    Past,
    /// One without a number.
    Unnumbered,
}

impl Conversation {
    /// Takes the number of a request.
    pub fn turn(&mut self, number: Number) -> RequestOrder {
        if number == Number::NONE {
            return RequestOrder::Unnumbered;
        }
        if number == self.last {
            return RequestOrder::Again;
        }
        if !number.is_after(self.last) {
            return RequestOrder::Past;
        }
        *self = Self {
            last: number,
            response: None,
        };
        RequestOrder::New
    }

    /// Keeps a response for a request that may come again.
    pub fn keep(&mut self, number: Number, response: &Response) {
        if number == self.last {
            self.response = Some(response.clone());
        }
    }

    /// Answer to the last request; none while it is carried out.
    pub fn response(&self) -> Option<&Response> {
        self.response.as_ref()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_number_is_new_once() {
        let mut conversation = Conversation::default();
        let first = Number::FIRST;
        assert_eq!(conversation.turn(Number::NONE), RequestOrder::Unnumbered);
        assert_eq!(conversation.turn(first), RequestOrder::New);
        assert_eq!(conversation.turn(first), RequestOrder::Again);
        let third = first.next().next();
        assert_eq!(conversation.turn(third), RequestOrder::New);
        // The second was overtaken.
        assert_eq!(conversation.turn(first.next()), RequestOrder::Past);
        assert_eq!(conversation.turn(third), RequestOrder::Again);
        assert_eq!(conversation.turn(Number::NONE), RequestOrder::Unnumbered);
    }

    #[test]
    fn only_the_last_requests_response_is_kept() {
        let mut conversation = Conversation::default();
        let (first, second) = (Number::FIRST, Number::FIRST.next());
        conversation.turn(first);
        assert!(conversation.response().is_none());
        conversation.keep(first, &Response::Lookup);
        assert!(matches!(conversation.response(), Some(Response::Lookup)));
        conversation.turn(second);
        conversation.keep(first, &Response::Board);
        assert!(conversation.response().is_none());
    }
}
