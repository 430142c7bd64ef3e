//! The conversation with a host: which of its requests is a new one, and what the last one was answered with.
//!
//! A request whose answer was lost comes again under its number, and is answered as before; it is not carried out twice. One
//! that was overtaken by another is not carried out any more: its host has given it up.

use ihd_shared::wire::number::Number;

use crate::transmit_queue::Answer;

/// The last request, and its answer once there is one.
#[derive(Default)]
pub struct Conversation {
    last: Number,
    answer: Option<Answer>,
}

/// Place of a request in the conversation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turn {
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
    pub fn turn(&mut self, number: Number) -> Turn {
        if number == Number::NONE {
            return Turn::Unnumbered;
        }
        if number == self.last {
            return Turn::Again;
        }
        if !number.is_after(self.last) {
            return Turn::Past;
        }
        *self = Self {
            last: number,
            answer: None,
        };
        Turn::New
    }

    /// Keeps an answer for a request that may come again.
    pub fn keep(&mut self, number: Number, answer: &Answer) {
        if number == self.last {
            self.answer = Some(answer.clone());
        }
    }

    /// Answer to the last request; none while it is carried out.
    pub fn answer(&self) -> Option<&Answer> {
        self.answer.as_ref()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_number_is_new_once() {
        let mut conversation = Conversation::default();
        let first = Number::FIRST;
        assert_eq!(conversation.turn(Number::NONE), Turn::Unnumbered);
        assert_eq!(conversation.turn(first), Turn::New);
        assert_eq!(conversation.turn(first), Turn::Again);
        let third = first.next().next();
        assert_eq!(conversation.turn(third), Turn::New);
        // The second was overtaken.
        assert_eq!(conversation.turn(first.next()), Turn::Past);
        assert_eq!(conversation.turn(third), Turn::Again);
        assert_eq!(conversation.turn(Number::NONE), Turn::Unnumbered);
    }

    #[test]
    fn only_the_last_requests_answer_is_kept() {
        let mut conversation = Conversation::default();
        let (first, second) = (Number::FIRST, Number::FIRST.next());
        conversation.turn(first);
        assert!(conversation.answer().is_none());
        conversation.keep(first, &Answer::Lookup);
        assert!(matches!(conversation.answer(), Some(Answer::Lookup)));
        conversation.turn(second);
        conversation.keep(first, &Answer::Board);
        assert!(conversation.answer().is_none());
    }
}
